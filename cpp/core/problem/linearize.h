#pragma once

#include "core/problem/problem_view.h"
#include "core/residuals/reprojection.h"

namespace bundle {

/// Residuals and derivatives of every observation, each array of its own, row-major, n
/// observations.
struct Linearization {
  double* residual = nullptr;  ///< n x 2, pixels
  double* d_pose = nullptr;    ///< n x 2 x 6, by the chart (w, t) of reprojection.h
  double* d_params = nullptr;  ///< n x 2 x camera_params_stride, zero beyond the model's parameters
  double* d_point = nullptr;   ///< n x 2 x 3
};

/// Evaluates all observations with each image's rotation turned by Exp(w), w from rotation_offsets
/// (num_images x 3). Observations that do not count under `cheirality` are zero throughout.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void Linearize(const ProblemView& problem, const double* rotation_offsets, Cheirality cheirality,
               const Linearization& out);

}  // namespace bundle
