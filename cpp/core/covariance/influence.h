#pragma once

/// Influence: how a quantity of the solution depends on each measurement.
///
/// Let g be the gradient of a quantity q w.r.t. all free unknowns, and J~, r~ and C = H^- as in
/// reliability.h. One adjoint solve, a = C g, with the points eliminated
///
///   S a_c = g_c - sum Y_p g_p,        a_p = V_p^-1 g_p - Y_p^T a_c,
///
/// gives the variance g^T a of q, and with the rows (J~ a)_i its derivative w.r.t. every
/// measurement: the prediction minus the measurement is r~, so that dq/dz_i = (J~ a)_i in sigmas.
/// As sum (J~ a)_i^2 = a^T H a = g^T a, the squares are shares of the variance.
///
/// A quantity that a free motion of the world changes has no derivative: with the free similarities
/// N (free_gauge.h), N^T g must vanish. Then J~ a is the same for any C.
///
/// One step of Gauss-Newton moves q by -(J~ a)^T r~, which is 0 at a minimum. Without the
/// measurements I (rank formula, of the matrix identity of Sherman, Morrison and Woodbury),
///
///   dq = (J~ a)_I^T (I - H_II)^+ r~_I,        H_II = J~_I C J~_I^T.
///
/// For one observation, H_II is its leverage (leverages.h). With H_II u = u, a direction of the
/// unknowns is undetermined without the observation, and r~^T u = 0 at a minimum; q must not change
/// along it. For all observations of a point, which then is no unknown any more, the point is
/// eliminated first. With T = A - B Y^T, its rows by the camera parameters,
///
///   dq = (T a_c)^T (I - T C T^T)^-1 r~        if g_p = 0; B^T r~ = 0 at a minimum,
///
/// which has full rank unless the other points leave camera parameters undetermined. The weights of
/// a robust loss are constant.

#include <vector>

#include "core/covariance/covariance.h"

namespace bundle {

/// The gradient of a quantity.
struct InfluenceOptions {
  std::vector<double> images;   ///< num_images x 6, by (w, t) about the problem's origin
  std::vector<double> cameras;  ///< num_cameras x stride
  std::vector<double> points;   ///< num_points x 3
};

/// Whose deletions are wanted; each takes more time than all else.
enum class Deletions { kNone, kObservations, kPoints };

struct InfluenceOutput {
  double variance = 0;
  double step = 0;              ///< -(J~ a)^T r~ over all measurements
  double gauge_share = 0;       ///< ||N^T g|| over the sum of the absolute values of its terms
  LargeVector<double> along;    ///< num_observations x 2: (J~ a)_i; NaN if it does not count
  LargeVector<double> weights;  ///< num_observations: rho' of the loss, likewise
  /// dq without each observation or point; NaN where it has no value. Empty unless wanted.
  LargeVector<double> without;
  std::vector<double> factor_share;  ///< per factor ||(J~ a)_i||^2; NaN if it has no value
  CovarianceOutput sums;             ///< as in ReliabilityOutput
};

/// Throws as ComputeReliability.
InfluenceOutput ComputeInfluence(const AdjustmentProblem& problem, const SolveOptions& options,
                                 const InfluenceOptions& gradient, Deletions wanted);

}  // namespace bundle
