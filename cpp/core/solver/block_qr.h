#pragma once

/// Sparse QR factorisation by blocks: variables are eliminated one after the other, each by
/// Householder's reflections on the dense rows that touch it.
///
/// The rows that touch the first variable of the order, stacked, are reflected so that all but as
/// many as it has columns are zero in these:
///
///   Q^T [A_v  A_rest  b] = [R_v  R_rest  d],
///                          [ 0   A'_rest b']
///
/// the first line is part of R, the second is rows of the remaining variables and waits for the
/// next of them. That is the multifrontal method with a front a variable (J. W. H. Liu, The
/// multifrontal method for sparse matrix solution, SIAM Review 34, 1992); fronts with over twice as
/// many rows as columns are reduced to a triangle first. The order is that of approximate minimum
/// degree on the variables. A variable may get fewer rows than columns: R_v is then singular.

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
  /// `sizes`: columns of each variable, which lie one after the other. Of `rows` the variables
  /// count. `staying`: variables that are not eliminated.
  BlockQr(std::vector<int> sizes, const std::vector<RowBlock>& rows,
          const std::vector<int>& staying = {});

  /// Factorises the rows, of the variables of the constructor.
  void Factorize(std::vector<RowBlock> rows);

  int num_columns() const { return begin_.back(); }
  /// x that minimises ||A x - b||. Not finite where R is singular.
  Eigen::VectorXd Solve() const;
  /// (R^T R)^-1 y
  Eigen::VectorXd SolveNormal(const Eigen::VectorXd& y) const;
  /// |R_cc| of each column; infinite if its variable is kept.
  Eigen::VectorXd Pivots() const;
  /// Rows of the kept variables.
  const std::vector<RowBlock>& rest() const { return rest_; }

 private:
  struct Row {
    std::vector<int> variables;  ///< first the one that was eliminated
    Eigen::MatrixXd matrix;      ///< its size x (columns of the variables, d)
  };
  Row Eliminate(int variable, std::vector<RowBlock> pending, RowBlock* rest) const;
  Eigen::VectorXd BackSubstitute(const Eigen::VectorXd& right) const;
  int Place(const RowBlock& block) const;

  std::vector<int> sizes_, begin_;
  std::vector<int> order_, position_;
  size_t num_eliminated_;  ///< variables that come first in the order
  std::vector<Row> r_;     ///< in the order of the elimination
  std::vector<RowBlock> rest_;
};

}  // namespace bundle
