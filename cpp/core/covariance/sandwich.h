#pragma once

/// The sandwich covariance: the scatter of a solution if the variances of the residuals differ from
/// those that the weights assume.
///
/// A minimiser of sum 1/2 rho(||r||^2) moves by delta = -H^-1 g for a gradient g = sum psi_i, with
/// psi_i = J~_i^T r~_i the contribution of observation i (observation_rows.h). If the observations
/// are independent, then for any distribution (P. J. Huber, 1967; H. White, 1982),
///
///   cov delta = H^-1 M H^-1,        M = sum psi_i psi_i^T.
///
/// H is the derivative of the gradient. It includes second derivatives of the loss but not of the
/// residuals: sum J^T (rho' I + 2 rho'' r r^T) J. With the weights rho' alone, as in solvers,
/// outliers would count as information, and the covariance would be too small.
///
/// Factors of prior knowledge (priors, control points) have a known sigma and enter M by their
/// information J^T J, the expectation of psi psi^T.
///
/// With the points eliminated (reduced_system.h), let Y_p = W_p V_p^-1. Let g_i and G_i be the
/// entries of psi_i for the point and for the camera parameters. Over the observations i of point
/// p, P_p = sum g_i g_i^T and F_p = sum G_i g_i^T. Then
///
///   delta_c = S^-1 (G - sum Y_p g_p),     cov delta_c = C B C =: D,     C = S^-1,
///   B = sum_i G_i G_i^T + sum_p (Y_p P_p Y_p^T - F_p Y_p^T - Y_p F_p^T),
///   cov delta_p = V^-1 (P + W^T D W - W^T C E - (W^T C E)^T) V^-1,      E = F - Y P,
///
/// where B has the blocks of S, and only these blocks of C and D are needed. Unlike C, D has no
/// recursion; its columns are computed by solves, some hundred at a time. For the effect of inner
/// constraints see scatter_gauge.h.

#include <vector>

#include "core/covariance/reduced_system.h"
#include "core/covariance/scatter_gauge.h"

namespace bundle {

/// P and F of one point.
struct PointScores {
  double p[9];            ///< 3 x 3
  std::vector<double> f;  ///< as PointBlocks::w
};

/// Sums the scores of the point assembled last. `prior` as in PointAssembler::Tracks, or nullptr.
void SumScores(const PointBlocks& blocks, const PointAssembler& assembler, const double* prior,
               PointScores* scores);

/// Returns S of H with the second derivatives of the loss. It may be indefinite if the state is not
/// a minimum. The system includes these second derivatives.
BlockValues SumBread(const ReducedSystem& system);

/// E_p = F - Y P, rows as in PointBlocks::w.
std::vector<double> ScoresBesidePoint(const PointBlocks& blocks, const PointScores& scores);

/// Returns B, with the structure of S, and adds the sums for `gauge`, unless it is nullptr.
BlockValues SumMeat(const ReducedSystem& system, ScatterGauge* gauge);

/// Returns D at the blocks of S, for a factorised system; the D' of scatter_gauge.h, unless `gauge`
/// is nullptr.
LinearSolution SolveForScatter(ReducedSystem* system, const BlockValues& meat,
                               const ScatterGauge* gauge, BlockValues* scatter);

/// M x, for vectors of all unknowns.
FullVectors MeatTimes(const ReducedSystem& system, const FullVectors& x);

}  // namespace bundle
