#pragma once

/// S of a small system, and B of its sandwich, in long doubles.
///
/// Both are sums of squares of rows (eliminated_rows.h),
///
///   S = sum_p T_p^T T_p,        B = sum_i t_i t_i^T,    t_i = G_i - Y_p g_i    (sandwich.h),
///
/// so that long doubles keep in the squares the digits that doubles have in the rows. They are
/// slow: a point takes track length x (number of unknowns of its images)^2 operations.

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "core/covariance/reduced_system.h"

namespace bundle {

using LongMatrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

/// S, with both triangles.
LongMatrix SumSystemOfRows(const ReducedSystem& system);

/// B, with both triangles.
LongMatrix SumMeatOfRows(const ReducedSystem& system);

/// One row t_i per observation i of a point, by the unknowns of UnknownsOf: the camera parameters'
/// part G_i of its contribution to the gradient, reduced by that of the point. Then one row per
/// residual of the factors on this point alone, from its row of the Jacobian.
Eigen::MatrixXd FindReducedShares(const ReducedSystem& system, int point, const PointBlocks& blocks,
                                  const PointAssembler& rows);

/// Unknowns of the point's blocks, one after the other.
std::vector<int> UnknownsOf(const ParameterLayout& layout, const PointBlocks& blocks);

/// L of S = L L^T; empty if S is not positive definite.
std::optional<LongMatrix> LongCholesky(const LongMatrix& s);

/// Replaces b by (L L^T)^-1 b.
void SolveLong(const LongMatrix& lower, LongMatrix* b);

}  // namespace bundle
