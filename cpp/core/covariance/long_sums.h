#pragma once

/// S of a small system, and B of its sandwich, in long doubles.
///
/// Both are sums of squares of rows (eliminated_rows.h),
///
///   S = sum_p T_p^T T_p,        B = sum_i t_i t_i^T,    t_i = G_i - Y_p g_i    (sandwich.h),
///
/// and long doubles keep of the squares what doubles keep of the rows. They are slow: of a point,
/// its track x (the unknowns of its images)^2 of them.

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "core/covariance/reduced_system.h"

namespace bundle {

using LongMatrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

/// The whole of a dense symmetric matrix of which the lower triangle is stored.
LongMatrix Whole(const std::vector<double>& values, Eigen::Index n);

/// S, whole.
LongMatrix SumSystemOfRows(const ReducedSystem& system);

/// B, whole.
LongMatrix SumMeatOfRows(const ReducedSystem& system);

/// The share psi_i of the gradient of each observation of a point, a row each; of its own factors
/// those of their Jacobian. G_i is reduced to t_i.
struct ReducedShares {
  Eigen::MatrixXd of_unknowns;  ///< t, by the unknowns of UnknownsOf
  Eigen::MatrixXd of_point;     ///< g, three columns
};
ReducedShares FindReducedShares(const ReducedSystem& system, int point, const PointBlocks& blocks,
                                const PointAssembler& rows);

/// Unknowns of its blocks, one after the other.
std::vector<int> UnknownsOf(const ParameterLayout& layout, const PointBlocks& blocks);

/// L of S = L L^T; nothing if S is not positive definite.
std::optional<LongMatrix> LongCholesky(const LongMatrix& s);

/// b to (L L^T)^-1 b.
void SolveLong(const LongMatrix& lower, LongMatrix* b);

}  // namespace bundle
