#pragma once

/// The Jacobian of a factor graph as a sparse matrix, for methods that work on J instead of J^T J.

#include <Eigen/SparseCore>
#include <vector>

#include "core/graph/factor_graph.h"
#include "core/solver/block_qr.h"

namespace bundle {

/// The free columns of a graph's Jacobian, and its evaluation.
class GraphJacobian {
 public:
  using Sparse = Eigen::SparseMatrix<double>;
  using Values = std::vector<std::vector<double>>;

  /// Keeps a reference to the graph.
  explicit GraphJacobian(const FactorGraph& graph);

  /// Free columns of each variable.
  std::vector<int> sizes() const;
  int num_columns() const { return num_columns_; }
  int num_rows() const { return num_rows_; }

  /// Columns of each factor's free Jacobian, multiplied by a scale per column, followed by -r.
  std::vector<RowBlock> Rows(const Sparse& jacobian, const Eigen::VectorXd& residual,
                             const Eigen::VectorXd& scale) const;
  /// Returns the cost at the values, NaN if a factor has no value. Computes J and r, corrected for
  /// losses, if both are requested.
  double Evaluate(const Values& values, Eigen::VectorXd* residual, Sparse* jacobian) const;
  /// to = `from` moved by the step of the free columns.
  void Move(const Values& from, const Eigen::VectorXd& step, Values* to) const;
  /// ||x|| over the variables that are not completely constant.
  double Norm(const Values& values) const;

 private:
  const FactorGraph& graph_;
  std::vector<std::vector<int>> column_;  ///< per coordinate of each variable; -1: constant
  int num_columns_ = 0, num_rows_ = 0;
};

}  // namespace bundle
