#pragma once

#include <cstdint>

#include "core/problem/problem_view.h"

namespace bundle {

/// The reprojection error of every observation at the problem's own values.
///
/// errors (num_observations): ||r|| in pixels by the formula, also behind the camera; NaN where the
/// formula has no value. behind (num_observations): 1 where the camera cannot see the point.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void ComputeReprojectionErrors(const ProblemView& problem, int num_threads, double* errors,
                               uint8_t* behind);

/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void CheckCameraModelsKnown(const ProblemView& problem);

}  // namespace bundle
