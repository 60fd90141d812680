#pragma once

/// Marginal covariances of poses, intrinsics and points at a solution.
///
/// With the normal equations of reduced_system.h, C = S^-1 is the covariance of the unknowns of the
/// camera parameters, with all other unknowns marginalised. The covariance of a point is
///
///   C_p = V^-1 + V^-1 W^T C W V^-1,
///
/// which needs the blocks of C for pairs of blocks that share the point. These are blocks of S, and
/// therefore included in the selected inverse (linear/selected_inverse.cpp). All covariances
/// together take two or three factorisations. With constant cameras, the covariance would be only
/// V^-1, the conditional one.
///
/// The map M (observation_rows.h) transforms unknowns u of an image's blocks to its (w, t) and
/// parameters. Their joint covariance is M C_uu M^T, also for rigs and ties. At the problem's own
/// values, w is the left perturbation in radians, R to Exp(w) R. Constant parameters have
/// covariance zero.
///
/// A relative pose, T_ba = T_b T_a^-1, moves with the poses a and b, by the same perturbations, as
///
///   w_ba = w_b - R_ba w_a,      t_ba' = t_b' - R_ba t_a' + [R_ba t_a]x w_ba.
///
/// A linear function of the poses and parameters of all images, and of points, has the coefficients
/// m = sum M_i^T f_i - sum W_p V_p^-1 f_p by the unknowns. Any number of functions has the joint
/// covariance m^T C m' + sum f_p^T V_p^-1 f_p', with one solve each.
///
/// All covariances assume residuals with a sigma of one pixel, or with their own sigmas. The output
/// includes sum r^T W r over all measurements, for scaling them.

#include <cstdint>
#include <utility>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/scratch/large_vector.h"

namespace bundle {

struct CovarianceOptions {
  bool inner = true;      ///< inner constraints; false: the gauge of SolveOptions::gauge
  bool sandwich = false;  ///< sandwich.h
  bool of_points = true;
  bool of_images = true;  ///< false: `steps` and sums only, which need one factorisation of S
  /// Small systems in long doubles (long_sums.h): all digits where doubles have a few, at ten times
  /// the time.
  bool long_sums = true;
  /// Linear functions whose joint covariance is wanted: functions x num_images x (6 + stride), the
  /// derivatives w.r.t. (w, t) about the problem's origin and the image's camera parameters.
  std::vector<double> functions;
  std::vector<int> function_points;           ///< points on which the functions depend, too
  std::vector<double> functions_of_points;    ///< functions x function_points x 3
  std::vector<std::pair<int, int>> relative;  ///< image pairs (a, b), for cam_b_from_cam_a
};

/// Row-major; `stride` is that of the problem's camera_params.
struct CovarianceOutput {
  std::vector<double> poses;      ///< num_images x 6 x 6
  std::vector<double> frames;     ///< num_frames x 6 x 6
  std::vector<double> sensors;    ///< num_sensors x 6 x 6
  std::vector<double> cameras;    ///< num_cameras x stride x stride; NaN for constant parameters
  std::vector<double> twists;     ///< num_images x 6 x 6; empty without rolling shutters
  std::vector<double> readouts;   ///< num_cameras: variances; NaN for constant readouts; or empty
  LargeVector<double> points;     ///< num_points x 3 x 3; NaN for undetermined points
  std::vector<double> relative;   ///< pairs x 6 x 6
  std::vector<double> functions;  ///< functions x functions
  std::vector<int> null_points;   ///< points without parallax, ascending
  double weighted_squares =
      0;                      ///< sum of squared residuals, divided by sigma, weighted by the loss
  int64_t num_residuals = 0;  ///< number of independent residuals, of observations and factors
  int64_t num_parameters =
      0;  ///< number of free, determined parameters; the gauge is not subtracted
  /// Decrease of the cost by one more step, as predicted by the model; 0 at a minimum.
  double predicted_decrease = 0;
  /// The movement of the poses in this step, as (w, t) about the problem's origin: num_images x 6.
  /// Along free similarities it is arbitrary.
  std::vector<double> steps;
  int gauge_degrees = 0;  ///< number of parameters that only the inner constraints determine
  std::vector<Warning> warnings;
};

/// Evaluates all outputs at the problem's own values, which should be a minimum under these
/// options. The problem must be valid, with known camera models.
///
/// Throws InputError as ReducedSystem does, and if the normal equations are singular beyond the
/// gauge, or if the selected gauge leaves motions free.
CovarianceOutput ComputeCovariance(const AdjustmentProblem& problem, const SolveOptions& options,
                                   const CovarianceOptions& wanted);

}  // namespace bundle
