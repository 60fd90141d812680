#pragma once

/// Elimination of a point from its rows, for systems in which the normal equations would lose
/// digits.
///
/// The error of a floating-point sum J^T J is up to eps |J|^T |J|; that of its inverse is eps times
/// the square of J's condition. For a point's rows (J_p J_c), let
///
/// J_p Z = Q [R; 0],      Z an orthonormal basis of the determined directions of the point (3 x
/// rank),
///
/// by Householder reflections. The last rows of Q^T J_c =: T depend on the camera parameters alone.
/// The first rows give the elimination:
///
///   S = sum_p T_p^T T_p,      V_p^-1 = Z R^-1 R^-T Z^T,      Y_p^T = Z R^-1 (Q^T J_c)_1,
///
/// with errors of eps times the condition of J_p.

#include <Eigen/Core>
#include <algorithm>
#include <utility>
#include <vector>

#include "core/covariance/point_blocks.h"

namespace bundle {

/// Rows of an observation by block b, 2 x its size.
using TwoRows = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
Eigen::Map<const TwoRows> RowsByBlock(const ObservationRows& rows, int b);

/// Rows of the point assembled last: left(observation) (k x 2) times the two rows of each
/// observation, then `priors`, the rows of its own factors, three columns each. The columns are
/// three of the point, then those of PointBlocks::blocks.
template <typename Left>
Eigen::MatrixXd AllRows(const PointBlocks& blocks, const PointAssembler& assembler,
                        const std::vector<double>& priors, const Left& left) {
  using Rows3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  constexpr Eigen::Index kEach =
      decltype(left(std::declval<const ObservationRows&>()))::RowsAtCompileTime;
  const auto num_priors = static_cast<Eigen::Index>(priors.size() / 3);
  const Eigen::Index num_observed = kEach * assembler.num_rows();
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(num_observed + num_priors, 3 + blocks.begin.back());
  for (int i = 0; i < assembler.num_rows(); ++i) {
    const ObservationRows& from = assembler.row(i);
    const auto factor = left(from);
    auto to = rows.middleRows(kEach * i, kEach);
    to.leftCols(3) = factor * Eigen::Map<const TwoRows>(from.point, 2, 3);
    for (int b = 0; b < from.num_blocks; ++b) {
      const auto at = std::lower_bound(blocks.blocks.begin(), blocks.blocks.end(), from.block[b]);
      to.middleCols(3 + blocks.begin[at - blocks.blocks.begin()], from.size[b]) +=
          factor * RowsByBlock(from, b);
    }
  }
  rows.bottomLeftCorner(num_priors, 3) = Eigen::Map<const Rows3>(priors.data(), num_priors, 3);
  return rows;
}

class EliminatedRows {
 public:
  /// Eliminates the point assembled last. `priors`: rows of its own factors, three columns each.
  EliminatedRows(const PointBlocks& blocks, const PointAssembler& assembler,
                 const std::vector<double>& priors);

  /// T, by the unknowns of PointBlocks::blocks.
  const Eigen::MatrixXd& rest() const { return rest_; }
  /// Sets V^-1 and Y, without null directions.
  void Store(PointBlocks* blocks) const;

 private:
  Eigen::MatrixXd rest_;
  Eigen::MatrixXd root_;  ///< Z R^-1, 3 x rank
  Eigen::MatrixXd top_;   ///< (Q^T J_c)_1
};

}  // namespace bundle
