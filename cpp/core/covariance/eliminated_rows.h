#pragma once

/// A point eliminated from its rows, where the normal equations would lose digits.
///
/// A sum J^T J in floating point is off by up to eps |J|^T |J|, and its inverse by eps times the
/// square of J's condition. Of a point's rows (J_p J_c) let
///
///   J_p Z = Q [R; 0],      Z an orthonormal basis of what is known of the point (3 x rank),
///
/// by Householder's reflections. The last rows of Q^T J_c =: T are those of the camera parameters
/// alone, and the first give the rest:
///
///   S = sum_p T_p^T T_p,      V_p^-1 = Z R^-1 R^-T Z^T,      Y_p^T = Z R^-1 (Q^T J_c)_1,
///
/// with errors of eps times the condition of J_p. With the second derivatives of the loss
/// (observation_rows.h) an observation's two rows are multiplied by I + gamma r r^T, whose square
/// is I + beta r r^T.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/point_blocks.h"

namespace bundle {

/// I + gamma r r^T; false where an observation counts negatively along its residual.
bool RootOfCurvature(const ObservationRows& rows, Eigen::Matrix2d* root);

/// Of block b of an observation, 2 x its size.
using TwoRows = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
Eigen::Map<const TwoRows> RowsByBlock(const ObservationRows& rows, int b);

/// The first column of a block of the layout in PointBlocks::w.
Eigen::Index FirstColumn(const PointBlocks& blocks, int block);

class EliminatedRows {
 public:
  /// Of a point that was just assembled; `priors`: rows of its own factors, three columns each.
  EliminatedRows(const PointBlocks& blocks, const PointAssembler& assembler,
                 const std::vector<double>& priors);

  /// T, by the unknowns of PointBlocks::blocks.
  const Eigen::MatrixXd& rest() const { return rest_; }
  /// Sets V^-1 and Y, without what is null.
  void Store(PointBlocks* blocks) const;

 private:
  Eigen::MatrixXd rest_;
  Eigen::MatrixXd root_;  ///< Z R^-1, 3 x rank
  Eigen::MatrixXd top_;   ///< (Q^T J_c)_1
};

}  // namespace bundle
