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

/// Fills both triangles of a dense symmetric matrix from the stored lower triangle.
LongMatrix Whole(const BlockValues& values, Eigen::Index n);

/// S, with both triangles.
LongMatrix SumSystemOfRows(const ReducedSystem& system);

/// B, with both triangles.
LongMatrix SumMeatOfRows(const ReducedSystem& system);

/// One row per observation i of a point: its contribution psi_i to the gradient. Then one row per
/// residual of the factors on this point alone: its row of the Jacobian. In all rows, the part of
/// the other unknowns is reduced, as from G_i to t_i.
struct ReducedShares {
  Eigen::MatrixXd of_unknowns;  ///< t, by the unknowns of UnknownsOf
  Eigen::MatrixXd of_point;     ///< g, three columns
};
ReducedShares FindReducedShares(const ReducedSystem& system, int point, const PointBlocks& blocks,
                                const PointAssembler& rows);

/// Unknowns of the point's blocks, one after the other.
std::vector<int> UnknownsOf(const ParameterLayout& layout, const PointBlocks& blocks);

/// L of S = L L^T; empty if S is not positive definite.
std::optional<LongMatrix> LongCholesky(const LongMatrix& s);

/// Replaces b by (L L^T)^-1 b.
void SolveLong(const LongMatrix& lower, LongMatrix* b);

}  // namespace bundle
