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
/// H is the expected derivative of the gradient: the Gauss-Newton matrix of the solvers, in which
/// outliers would count as information, times the curvature kappa of the loss (leverages.h).
/// Residuals at the solution are smaller than the errors, so M has the residuals r^ corrected for
/// their leverage. Factors of prior knowledge (priors, control points) have a known
/// sigma and enter M by their information J^T J, the expectation of psi psi^T.
///
/// With the points eliminated (reduced_system.h), let Y_p = W_p V_p^-1. Let g_i and G_i be the
/// entries of psi_i for the point and for the camera parameters. Over the observations i of point
/// p, P_p = sum g_i g_i^T and F_p = sum G_i g_i^T. Then
///
///   delta_c = S^-1 (G - sum Y_p g_p),     cov delta_c = C B C =: D,     C = S^-1,
///   B = sum_i G_i G_i^T + sum_p (Y_p P_p Y_p^T - F_p Y_p^T - Y_p F_p^T).
///
/// A point has too few observations for its own scatter: two rays leave one residual, from which no
/// variance can be read, corrected or not. Its own part, given the cameras, is therefore that of
/// the common variance s^2 of all residuals rho' r under the loss, with the derivatives J_p without
/// its weights:
///
///   delta_p = V^-1 g_p - Y_p^T delta_c,
///   cov delta_p = V^-1 P_p V^-1 + Y_p^T D Y_p,     P_p = s^2 sum J_p^T J_p + the prior of p.
///
/// B has the blocks of S, and only these blocks of C and D are needed. Unlike C, D has no
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

/// Adds J^T J of the factors of camera parameters, with the structure of S.
void AddFactors(const ReducedSystem& system, BlockValues* values);

/// Returns H with the points eliminated, with the structure of S.
BlockValues SumBread(const ReducedSystem& system);

/// The expected P of the point assembled last, for residuals of this variance.
void ExpectScatter(const PointAssembler& assembler, double variance, const double* prior,
                   double p[9]);

/// Returns B, with the structure of S, and adds the sums for `gauge`, unless it is nullptr.
/// `variance`: s^2.
BlockValues SumMeat(const ReducedSystem& system, double variance, ScatterGauge* gauge);

/// Returns D at the blocks of S, for a factorised system; with `gauge`, the D' of scatter_gauge.h.
LinearSolution SolveForScatter(ReducedSystem* system, const BlockValues& meat,
                               const ScatterGauge* gauge, BlockValues* scatter);

/// M x, for vectors of all unknowns.
FullVectors MeatTimes(const ReducedSystem& system, const FullVectors& x);

/// L^T x for L = (I; -Y^T), by which the points follow the cameras; no points remain.
FullVectors ReduceByPoints(const ReducedSystem& system, const FullVectors& x);
/// Sets the points of `to` to their part of L c + V^-1 P V^-1 x, for its cameras c.
void AddOwnScatter(const ReducedSystem& system, double variance, const FullVectors& x,
                   FullVectors* to);

}  // namespace bundle
