#pragma once

#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/camera_states.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

/// What moving, turning and scaling the world does to the camera side's unknowns: for each column
/// of the layout, its derivative by three translations, three rotations and the scale.
std::vector<double> Similarities(const ProblemView& problem, const ParameterLayout& layout,
                                 const CameraStates& cameras);

}  // namespace bundle::fused
