#pragma once

/// Reliability (W. Baarda, 1968): which errors of the observations the others would show.
///
/// Let J~ and r~ be the rows of observation_rows.h, of observations and factors, H = J~^T J~ and C
/// any inverse of H in a gauge. An error b of the measurements moves the solution by -C J~^T b (the
/// residual is prediction minus measurement) and the residuals by R b, up to the sign, with
///
///   R = I - J~ C J~^T,        tr R = residuals - determined parameters.
///
/// The blocks h = J~_i C J~_i^T on the diagonal are the leverages (leverages.h); for a factor of a
/// point, C is the point's block of H^-1, for one of camera parameters a block of S^-1, as factors
/// couple these in S. Let l be the least eigenvalue of R_ii = I - h, along u. An error along u of
/// length d0 / sqrt(l), in sigmas, shifts the test along u by d0: the largest error that the test
/// may miss. All observations of a point with two rays have l = 0 along the epipolar line, as the
/// point absorbs the error.
///
/// This error moves any function f of the unknowns by at most
///
///   |f^T C J~_i^T u| d0 / sqrt(l) <= sqrt(f^T C f) d0 sqrt((1 - l) / l)       (Cauchy, Schwarz),
///
/// so that d0 sqrt((1 - l) / l) bounds the movement in sigmas of f. The movement itself takes one
/// solve per observation. For the observations of the least l that is not below `least`, it is
/// compared with the covariances of all poses of images (6 x 6), and of the points (3 x 3) in the
/// images of these observations, as points elsewhere move with the poses alone,
///
///   sqrt(dx^T C_b^+ dx)    of a block b,
///
/// under inner constraints if the world is free (free_gauge.h).

#include <cstdint>
#include <vector>

#include "core/covariance/covariance.h"

namespace bundle {

struct ReliabilityOptions {
  double least = 0.02;    ///< least l at which an error is said to be checked
  int num_worst = 20;     ///< number of observations whose exact effect is wanted
  bool long_sums = true;  ///< as CovarianceOptions::long_sums
};

/// The effect of an error of length 1 / sqrt(l) sigmas along u.
struct ExternalEffect {
  int64_t observation = -1;
  int point = -1;           ///< the point that moves by the most sigmas; -1: none
  double point_sigmas = 0;  ///< and by how many, for d0 = 1
  int image = -1;           ///< the image that moves by the most sigmas; -1: none
  double image_sigmas = 0;
};

struct ReliabilityOutput {
  /// Per observation; NaN if it does not count.
  LargeVector<double> residuals;  ///< num_observations x 2: r~
  LargeVector<double> leverages;  ///< num_observations x 3: h_00, h_01, h_11
  LargeVector<double> weights;    ///< num_observations: rho' of the loss
  LargeVector<double> least;      ///< num_observations: l; NaN also for a weight of 0
  LargeVector<double> along;      ///< num_observations x 2: u, likewise
  /// Per factor; NaN if it has no value.
  std::vector<int> factor_measurements;   ///< its independent residuals
  std::vector<double> factor_redundancy;  ///< tr R_ii
  std::vector<double> factor_least;       ///< l of R_ii
  std::vector<double> factor_test;    ///< r~^T R_ii^+ r~, chi2 distributed with factor_rank degrees
  std::vector<int> factor_rank;       ///< directions with a redundancy of at least `least`
  std::vector<ExternalEffect> worst;  ///< ascending l
  CovarianceOutput sums;              ///< its sums, points without parallax and warnings alone
};

/// Evaluates the redundancies at the problem's own values, which should be a minimum under these
/// options; without a gauge of its own. Throws as ComputeCovariance.
ReliabilityOutput ComputeReliability(const AdjustmentProblem& problem, const SolveOptions& options,
                                     const ReliabilityOptions& wanted);

}  // namespace bundle
