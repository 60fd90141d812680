#pragma once

/// Normal equations of a linearised factor graph, factorised for analyses at its values.
///
/// H = J^T J over the free coordinates, a block per variable that has any. S = D H D has a unit
/// diagonal, so that units have no effect. S is factorised in the cheapest order
/// (linear/fill_ordering.h).

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/graph/factor_graph.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"

namespace bundle {

class GraphNormalEquations {
 public:
  /// The free columns of J of a factor, one variable after the other, and its rows.
  struct Rows {
    std::vector<int> variables;  ///< those with free coordinates, in the order of the columns
    Eigen::MatrixXd jacobian;
    Eigen::VectorXd residual;
  };

  /// Keeps references. `held`: 1 for a constant coordinate, for all tangent coordinates; at least
  /// one is free.
  GraphNormalEquations(const FactorGraph& graph, const LinearizedGraph& linear,
                       std::vector<uint8_t> held, int num_threads);

  int num_columns() const { return structure_.num_columns(); }
  /// First free column of a variable; -1 without one.
  int FirstColumn(int variable) const { return first_column_[variable]; }
  /// Tangent coordinate of each free column.
  const std::vector<int>& coordinates() const { return coordinates_; }
  /// Rows of a factor, with the free columns of J.
  Rows RowsOf(int64_t factor) const;
  /// D per column: the inverse root of H's diagonal, 1 where that is 0.
  const Eigen::VectorXd& scale() const { return scale_; }
  /// -J^T r
  const Eigen::VectorXd& descent() const { return descent_; }

  /// Factorises S + shift I. Returns the variable at which S is not positive definite, or -1.
  int Factorize(double shift);
  /// (S + shift I)^-1 X, after Factorize and before Invert.
  Eigen::MatrixXd Solve(const Eigen::MatrixXd& x);
  /// H X
  Eigen::MatrixXd Product(const Eigen::MatrixXd& x) const;
  /// J^T (J X) by all tangent coordinates, constant ones included.
  Eigen::MatrixXd ProductOfAll(const Eigen::MatrixXd& x) const;

  /// Replaces the factor by the blocks of the inverse.
  void Invert();
  /// Block of H^-1 for two variables with a common factor, after Invert.
  Eigen::MatrixXd InverseBlock(int row, int column) const;

 private:
  void FindColumns(const std::vector<uint8_t>& held);
  BlockStructure NaturalStructure() const;
  void Assemble();

  const FactorGraph& graph_;
  const LinearizedGraph& linear_;
  std::vector<int64_t> first_row_;  ///< per factor, and the end
  std::vector<int> column_;         ///< per tangent coordinate: its free column, -1 if constant
  std::vector<int> first_column_;   ///< per variable
  std::vector<int> num_free_;       ///< per variable
  std::vector<int> block_;          ///< per variable: its block in the elimination, -1 if none
  std::vector<int> variable_of_;    ///< per block of the elimination
  std::vector<int> coordinates_;    ///< per free column
  std::vector<int> place_;          ///< per free column: its place in the elimination
  BlockStructure structure_, compact_;
  std::unique_ptr<LinearSolver> solver_;
  std::vector<double> values_;  ///< S in compact_
  BlockSystem system_;
  Eigen::VectorXd scale_, descent_;
};

}  // namespace bundle
