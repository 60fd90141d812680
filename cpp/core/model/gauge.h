#pragma once

/// The gauge: fixed where the options ask for it, and its directions.

#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// Takes the seven degrees of freedom that no observation sees (rotation, translation, scale of the
/// world) out of `free`, unless two images or three points that are fixed already hold them.
/// Returns a sentence, to be shown to the user, where that could not be done as asked; else "".
std::string FixGauge(const ProblemView& problem, Gauge gauge, FreeParameters* free);

/// Translations, rotations and the scale of the world.
inline constexpr int kNumGaugeDirections = 7;

/// What moving, turning and scaling the world does to the camera parameters: for each column of
/// the layout, its derivative by three translations, three rotations and the scale.
std::vector<double> GaugeDirections(const ProblemView& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras);

}  // namespace bundle
