#pragma once

#include <cstdint>

#include "core/problem/problem_view.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/solve.h"

namespace bundle {

/// Of the observations that count at the start, how many may end behind their cameras.
inline constexpr double kMaxLostShare = 0.01;

/// Looks for observations that do not count at the solution: behind their cameras or, if those
/// behind count, without a projection. More of them than at the start, an image with no others, or
/// observations that would count but were left out, having been behind before, make a warning with
/// numbers and image ids. With more than `kMaxLostShare` lost the solution is not usable, as its
/// cost says little of it. `num_held`: observations with something to refine that hold a residual
/// at the solution (residuals/held_residual.h).
void JudgeLostObservations(const ProblemView& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output);

}  // namespace bundle
