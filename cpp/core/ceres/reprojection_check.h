#pragma once

#include <cstdint>

#include "core/problem/problem_view.h"
#include "core/residuals/reprojection.h"

namespace bundle {

/// The projection is singular at the camera's centre and, for some models, in the plane through it.
/// With L the distance of the point to the nearest of these, steps of the reference move the point
/// by less than L / 4 within its camera's frame, where central differences are a convergent power
/// series in step / L. The point's coordinates in that frame, R X + t, are only known to about
///
///   delta = eps (|R X| + |t|),
///
/// so that every derivative by pose and point is only known to delta / L: where that is large,
/// as for points that an earlier solve left at a camera's centre, there is nothing to compare with.

/// Where the Jacobians of checked observations go: num_checked x 2 x columns, row-major, columns
/// (w, t) of the pose, the camera's parameters (camera_params_stride), the point. What the model
/// does not have or never refines stays zero.
struct ReprojectionCheck {
  double* analytic = nullptr;     ///< by the cost function that a solve uses
  double* reference = nullptr;    ///< by Richardson extrapolation
  double* uncertainty = nullptr;  ///< of the reference
  double* ceres = nullptr;        ///< by ceres::GradientChecker; not a number where it gave up
  double* rounding = nullptr;     ///< num_checked: delta / L
  uint8_t* counts = nullptr;      ///< num_checked: 0 for an observation that contributes nothing
  uint8_t* agrees = nullptr;      ///< num_checked: GradientChecker's own verdict
  uint8_t* stable = nullptr;  ///< num_checked: the residual is the same with and without Jacobians
};

/// Checks the observations of these indices, each at its image's pose, which is written as Exp(w)
/// R0 with w = offsets (num_checked x 3): the Jacobian is tried away from the start of its chart.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void CheckReprojections(const ProblemView& problem, const int64_t* observations,
                        int64_t num_checked, const double* offsets, Cheirality cheirality,
                        double relative_precision, int num_threads, const ReprojectionCheck& out);

}  // namespace bundle
