#pragma once

/// Observations that do not count at the solution of a solve.

#include <cstdint>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Maximum share of the observations counted at the start that may end behind their cameras.
inline constexpr double kMaxLostShare = 0.01;

/// Counts, on all ranks, the observations with a held residual although they could count at the
/// problem's values, because they are in front of their cameras. `num_held`: number of observations
/// with free parameters and a held residual.
int64_t CountLeftOut(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const SolveOptions& options, int64_t num_held);

/// Counts observations that do not count at the solution: those behind their cameras or, if
/// observations behind cameras count, those without a projection. Warns, with numbers and image
/// ids, if there are more of them than at the start, if an image has only such observations, or if
/// observations were left out that would count now. If more than `kMaxLostShare` are lost, the
/// solution is not usable, because its cost covers too few observations. `num_held`: number of
/// observations with free parameters and a held residual at the solution (factors/reprojection.h).
void JudgeLostObservations(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output);

}  // namespace bundle
