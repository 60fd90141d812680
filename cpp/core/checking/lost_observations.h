#pragma once

/// Observations that do not count at the solution of a solve.

#include <cstdint>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Largest share of the observations counted at the start that may end behind their cameras.
inline constexpr double kMaxLostShare = 0.01;

/// Judges a solve with `num_held` observations with something to refine that hold a residual at the
/// problem's values, on all ranks, the number of those that could count: they are in front of their
/// cameras.
int64_t CountLeftOut(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const SolveOptions& options, int64_t num_held);

/// Looks for observations that do not count at the solution: behind their cameras or, if those
/// behind count, without a projection. More of them than at the start, an image with no others, or
/// observations that would count but were left out, having been behind before, make a warning with
/// numbers and image ids. With more than `kMaxLostShare` lost the solution is not usable, as its
/// cost says little of it. `num_held`: observations with something to refine that hold a residual
/// at the solution (factors/reprojection.h).
void JudgeLostObservations(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output);

}  // namespace bundle
