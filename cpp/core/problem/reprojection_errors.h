#pragma once

/// Reprojection errors of all observations, and their derivatives.

#include <cstdint>

#include "core/factors/reprojection.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// The reprojection error of every observation at the problem's own values.
///
/// errors (num_observations): ||r|| in pixels by the formula, also behind the camera; NaN if the
/// formula has no value. behind (num_observations): 1 if the camera cannot see the point. The
/// camera sees points for which the formula of its lens is defined, but with Cheirality::kZero not
/// beyond 90 degrees.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void ComputeReprojectionErrors(const ProblemView& problem, int num_threads, Cheirality cheirality,
                               double* errors, uint8_t* behind);

/// Reprojection residuals r of all observations (num_observations x 2).
void ComputeReprojectionResiduals(const ProblemView& problem, int num_threads,
                                  Cheirality cheirality, double* residuals, uint8_t* behind);

/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void CheckCameraModelsKnown(const ProblemView& problem);

/// Residuals and derivatives of every observation, in separate row-major arrays, for n
/// observations.
struct ReprojectionDerivatives {
  double* residual = nullptr;  ///< n x 2, pixels
  double* d_pose = nullptr;    ///< n x 2 x 6, by the chart (w, t) of reprojection.h
  double* d_params = nullptr;  ///< n x 2 x camera_params_stride, zero beyond the model's parameters
  double* d_point = nullptr;   ///< n x 2 x 3
  double* d_twist = nullptr;   ///< n x 2 x 6, zero for global shutters; nullptr: not needed
};

/// Evaluates all observations, with each image's rotation multiplied by Exp(w), where w is from
/// rotation_offsets (num_images x 3). All outputs of observations that do not count under
/// `cheirality` are zero.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void Linearize(const ProblemView& problem, const double* rotation_offsets, Cheirality cheirality,
               const ReprojectionDerivatives& out);

}  // namespace bundle
