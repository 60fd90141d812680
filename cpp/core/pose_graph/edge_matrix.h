#pragma once

/// Symmetric matrix with a block per pose and per edge of a graph, and its Cholesky factor.

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"
#include "core/pose_graph/block_pattern_of_edges.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Blocks are added; then the matrix is factorised in place, and solves. Vectors have the unknowns
/// of one pose after the other, in the order of the graph.
class EdgeMatrix {
 public:
  /// `ordering`: the elimination of the graph's poses, which are all free.
  EdgeMatrix(const PoseGraph& graph, int block_size, int num_threads, const FillOrdering& ordering);

  int block_size() const { return size_; }
  void Clear();

  /// Adds to block (i, i); only the lower triangle is read.
  template <typename Matrix>
  void AddDiagonal(int64_t i, const Matrix& block) {
    const int column = pattern_.block_of[i];
    double* const values = system_.values.data() +
                           structure_.ValueIndex(column, structure_.column_begin[column], 0, 0);
    const int64_t stride = structure_.panel_stride[column];
    for (int c = 0; c < size_; ++c) {
      for (int r = c; r < size_; ++r) values[c * stride + r] += block(r, c);
    }
  }

  /// Adds to block (i, j) of two poses that an edge joins.
  template <typename Matrix>
  void AddPair(int64_t i, int64_t j, const Matrix& block) {
    const int first = pattern_.block_of[i], second = pattern_.block_of[j];
    const int column = std::min(first, second), row = std::max(first, second);
    double* const values =
        system_.values.data() + structure_.ValueIndex(column, structure_.Entry(column, row), 0, 0);
    const int64_t stride = structure_.panel_stride[column];
    for (int c = 0; c < size_; ++c) {
      for (int r = 0; r < size_; ++r) {
        values[c * stride + r] += first == row ? block(r, c) : block(c, r);
      }
    }
  }

  /// Returns false if the matrix is not positive definite. The blocks are lost.
  bool Factorize();

  /// X of A X = B, a column per right-hand side.
  Eigen::MatrixXd Solve(const Eigen::MatrixXd& rhs);

 private:
  const int size_;
  const EdgePattern pattern_;
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  BlockSystem system_;
};

}  // namespace bundle
