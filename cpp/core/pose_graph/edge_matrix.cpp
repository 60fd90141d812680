#include "core/pose_graph/edge_matrix.h"

#include <stdexcept>

#include "core/linear/direct_solvers.h"

namespace bundle {

using Eigen::MatrixXd;

EdgeMatrix::EdgeMatrix(const PoseGraph& graph, int block_size, int num_threads,
                       const FillOrdering& ordering)
    : size_(block_size),
      pattern_(PatternOfEdges(graph, block_size, "auto", &ordering)),
      structure_(pattern_.structure) {
  solver_ = MakeSparseSolver(pattern_.ordering, num_threads, &structure_);
  Clear();
}

void EdgeMatrix::Clear() { system_.values.assign(structure_.num_values, 0.0); }

bool EdgeMatrix::Factorize() {
  return solver_->Factorize(&system_, {}).status == LinearStatus::kSuccess;
}

MatrixXd EdgeMatrix::Solve(const MatrixXd& rhs) {
  MatrixXd permuted(rhs.rows(), rhs.cols()), solution(rhs.rows(), rhs.cols());
  for (size_t k = 0; k < pattern_.pose_of.size(); ++k) {
    permuted.middleRows(static_cast<int64_t>(k) * size_, size_) =
        rhs.middleRows(int64_t{pattern_.pose_of[k]} * size_, size_);
  }
  for (int64_t k = 0; k < rhs.cols(); ++k) {
    const LinearSolution found =
        solver_->Solve(permuted.col(k).data(), 1, 0, solution.col(k).data());
    if (found.status != LinearStatus::kSuccess) throw std::runtime_error(found.message);
  }
  for (size_t k = 0; k < pattern_.pose_of.size(); ++k) {
    permuted.middleRows(int64_t{pattern_.pose_of[k]} * size_, size_) =
        solution.middleRows(static_cast<int64_t>(k) * size_, size_);
  }
  return permuted;
}

}  // namespace bundle
