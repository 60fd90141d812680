/// The columns of a cluster are made orthonormal in the metric diag(S), which makes radians,
/// lengths and pixels comparable and A = Q^T S Q well scaled. What depends on the columns before it
/// (three intrinsics and seven similarities of a single image are more than its nine unknowns) is
/// set to zero, and A gets a 1 on its diagonal there.

#include "core/fused/reduced/cluster_directions.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace bundle::fused {
namespace {

/// The norm a direction must keep once the components along those before it are taken away.
constexpr double kIndependent = 1e-7;

constexpr int kNumSimilarities = ReducedSystem::kNumSimilarities;

/// Gram and Schmidt's, in the order of the columns.
void Orthonormalize(ClusterDirections* directions) {
  Eigen::MatrixXd& q = directions->q;
  directions->is_idle.resize(q.cols());
  for (int m = 0; m < q.cols(); ++m) {
    const double norm = q.col(m).norm();
    for (int pass = 0; pass < 2; ++pass) {  // twice is enough (Kahan and Parlett)
      for (int before = 0; before < m; ++before) {
        q.col(m) -= q.col(before).dot(q.col(m)) * q.col(before);
      }
    }
    const double left = q.col(m).norm();
    const bool idle = !(left > kIndependent * norm);
    directions->is_idle[m] = idle;
    if (idle) {
      q.col(m).setZero();
    } else {
      q.col(m) /= left;
    }
  }
}

}  // namespace

bool MovesBlock(const ReducedStructure& structure, const std::vector<char>& moves, int block) {
  const auto first = moves.begin() + structure.offset[block];
  return std::any_of(first, first + structure.block_size(block),
                     [](char does_move) { return does_move != 0; });
}

ClusterDirections FindClusterDirections(const ReducedStructure& structure,
                                        const ReducedSystem& system, const std::vector<char>& moves,
                                        const std::vector<int>& blocks, int num_columns) {
  int num_rows = 0;
  for (const int j : blocks) num_rows += structure.block_size(j);
  ClusterDirections directions;
  directions.q = Eigen::MatrixXd::Zero(num_rows, num_columns);
  Eigen::VectorXd weight(num_rows);
  int row = 0;
  for (const int j : blocks) {
    int intrinsic = MovesBlock(structure, moves, j) ? kNumSimilarities : 0;
    for (int k = 0; k < structure.block_size(j); ++k, ++row) {
      const int column = structure.offset[j] + k;
      const int64_t diagonal = structure.ValueIndex(j, structure.column_begin[j], k, k);
      weight[row] = std::sqrt(system.values[diagonal]);
      if (moves[column] == 0) {
        directions.q(row, intrinsic++) = weight[row];
        continue;
      }
      const double* const similarities =
          &system.similarities[static_cast<size_t>(column) * kNumSimilarities];
      for (int m = 0; m < kNumSimilarities; ++m) {
        directions.q(row, m) = similarities[m] * weight[row];
      }
    }
  }
  Orthonormalize(&directions);
  for (row = 0; row < num_rows; ++row) directions.q.row(row) /= weight[row];
  return directions;
}

}  // namespace bundle::fused
