#pragma once

/// Test of the reprojection Jacobians of a problem against both references of gradient_check.h.

#include <cstdint>

#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"

namespace bundle {

/// Output arrays for checked observations. Jacobians are num_checked x 2 x columns, row-major. The
/// columns are (w, t) of the pose, the camera's parameters (camera_params_stride), the twist (6) if
/// any shutter rolls, and the point.
/// Columns that the model does not have or never refines stay zero.
struct ReprojectionCheck {
  double* analytic = nullptr;     ///< from the cost function of the solve
  double* reference = nullptr;    ///< by Richardson extrapolation
  double* uncertainty = nullptr;  ///< uncertainty of the reference
  double* ceres = nullptr;        ///< by ceres::GradientChecker; NaN if it failed
  double* rounding = nullptr;     ///< num_checked: delta / L
  uint8_t* counts = nullptr;      ///< num_checked: 0 for an observation that does not contribute
  uint8_t* agrees = nullptr;      ///< num_checked: GradientChecker's own verdict
  uint8_t* stable = nullptr;  ///< num_checked: the residual is the same with and without Jacobians
};

inline int NumCheckedColumns(const ProblemView& problem) {
  return 6 + problem.camera_params_stride + (problem.row_scale.empty() ? 0 : 6) + 3;
}

/// Checks the observations with these indices, each at its image's pose, which is written as Exp(w)
/// R0 with w = offsets (num_checked x 3). So the Jacobian is tested away from the origin of its
/// chart.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void CheckReprojections(const AdjustmentProblem& problem, const int64_t* observations,
                        int64_t num_checked, const double* offsets, Cheirality cheirality,
                        double relative_precision, int num_threads, const ReprojectionCheck& out);

}  // namespace bundle
