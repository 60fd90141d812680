#pragma once

/// Sparse QR factorisation by blocks: variables are eliminated one after the other, each by
/// Householder reflections of the dense rows that contain it.
///
/// The rows that contain the first variable of the order are stacked. If the variable has k
/// columns, reflections make these columns zero in all rows except the first k:
///
///   Q^T [A_v  A_rest  b] = [R_v  R_rest  d],
///                          [ 0   A'_rest b']
///
/// The first line is part of R. The second line contains only the remaining variables; it is stored
/// until the next of these is eliminated. That is the multifrontal method with a front per variable
/// (J. W. H. Liu, The multifrontal method for sparse matrix solution, SIAM Review 34, 1992). Fronts
/// with more than twice as many rows as columns are first reduced to a triangle. The order is
/// approximate minimum degree on the variables. If a variable has fewer rows than columns, R_v is
/// singular.

#include <Eigen/Core>
#include <vector>

namespace bundle {

/// Dense rows: columns of the variables one after the other, then the right-hand side.
struct RowBlock {
  std::vector<int> variables;
  Eigen::MatrixXd matrix;
};

class BlockQr {
 public:
  /// `sizes`: columns of each variable, one after the other. Only the variables of `rows` are used.
  /// `staying`: variables that are not eliminated.
  BlockQr(std::vector<int> sizes, const std::vector<RowBlock>& rows,
          const std::vector<int>& staying = {});

  /// Factorises the rows. They have the same variables as those of the constructor.
  void Factorize(std::vector<RowBlock> rows);

  int num_columns() const { return begin_.back(); }
  /// x that minimises ||A x - b||. Not finite if R is singular.
  Eigen::VectorXd Solve() const;
  /// (R^T R)^-1 y
  Eigen::VectorXd SolveNormal(const Eigen::VectorXd& y) const;
  /// |R_cc| of each column; infinite for columns of kept variables.
  Eigen::VectorXd Pivots() const;
  /// Rows of the kept variables.
  const std::vector<RowBlock>& rest() const { return rest_; }

 private:
  struct Row {
    std::vector<int> variables;  ///< starts with the eliminated variable
    Eigen::MatrixXd matrix;      ///< its size x (columns of the variables, d)
  };
  Row Eliminate(int variable, std::vector<RowBlock> pending, RowBlock* rest) const;
  Eigen::VectorXd BackSubstitute(const Eigen::VectorXd& right) const;
  int Place(const RowBlock& block) const;

  std::vector<int> sizes_, begin_;
  std::vector<int> order_, position_;
  size_t num_eliminated_;  ///< number of eliminated variables; these come first in the order
  std::vector<Row> r_;     ///< in the order of the elimination
  std::vector<RowBlock> rest_;
};

}  // namespace bundle
