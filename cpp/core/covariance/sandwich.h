#pragma once

/// The sandwich covariance: the scatter of a solution if the residuals do not have the variances of
/// their weights.
///
/// A minimiser of sum 1/2 rho(||r||^2) moves by delta = -H^-1 g for a gradient g = sum psi_i, psi_i
/// = J~_i^T r~_i the share of observation i (observation_rows.h). If the observations are
/// independent, whatever their distribution (P. J. Huber, 1967; H. White, 1982),
///
///   cov delta = H^-1 M H^-1,        M = sum psi_i psi_i^T.
///
/// H is the derivative of the gradient, second derivatives of the loss included, those of the
/// residuals not: sum J^T (rho' I + 2 rho'' r r^T) J. With the weights rho' alone, as solvers have
/// it, outliers would count as information, and the covariance be too small.
///
/// Factors of prior knowledge (priors, control points) have a known sigma and enter M by their
/// information J^T J, the expectation of psi psi^T.
///
/// By the elimination of the points (reduced_system.h), with Y_p = W_p V_p^-1 and, over the
/// observations i of point p, P_p = sum g_i g_i^T, F_p = sum G_i g_i^T for their shares g_i of the
/// point and G_i of the camera parameters,
///
///   delta_c = S^-1 (G - sum Y_p g_p),     cov delta_c = C B C =: D,     C = S^-1,
///   B = sum_i G_i G_i^T + sum_p (Y_p P_p Y_p^T - F_p Y_p^T - Y_p F_p^T),
///   cov delta_p = V^-1 (P + W^T D W - W^T C E - (W^T C E)^T) V^-1,      E = F - Y P,
///
/// where B has the blocks of S, and C and D are wanted at these blocks only. D has no recursion as
/// C has; its columns are solved for, some hundred at a time. What inner constraints make of it:
/// scatter_gauge.h.

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

/// S of H with the second derivatives of the loss; may be indefinite where there is no minimum. The
/// system is one of second order.
std::vector<double> SumBread(const ReducedSystem& system);

/// E_p = F - Y P, rows as in PointBlocks::w.
std::vector<double> ScoresBesidePoint(const PointBlocks& blocks, const PointScores& scores);

/// B, with the structure of S, and the sums for `gauge`, unless it is nullptr.
std::vector<double> SumMeat(const ReducedSystem& system, ScatterGauge* gauge);

/// D at the blocks of S, of a factorised system; that of scatter_gauge.h, unless `gauge` is
/// nullptr.
LinearSolution SolveForScatter(ReducedSystem* system, const std::vector<double>& meat,
                               const ScatterGauge* gauge, std::vector<double>* scatter);

/// M x, for vectors of all unknowns.
FullVectors MeatTimes(const ReducedSystem& system, const FullVectors& x);

}  // namespace bundle
