#pragma once

#include <memory>
#include <string>

#include "core/ceres/ceres_version.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// The elimination order for one solve, made anew each time because Ceres changes what it is given.
/// Group 0 is eliminated first: the points, or the images' blocks for kCamerasFirst; everything
/// else is group 1. nullptr for kAutomatic. `points` and `state` are where the parameter blocks
/// live.
std::shared_ptr<ceres::ParameterBlockOrdering> MakeOrdering(EliminationOrdering ordering,
                                                            const ParameterLayout& layout,
                                                            int num_points, double* points,
                                                            double* state);

/// True if group 0 would be empty although group 1 is not. Ceres then takes the one group for no
/// ordering at all and finds an independent set by itself.
bool NothingToEliminate(EliminationOrdering ordering, const ParameterLayout& layout);

}  // namespace bundle
