#pragma once

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/minimize/sigma_rule.h"

namespace bundle {

/// The Newton decrements at the values of a valid problem, whatever backend solves it; NaN if the
/// fused backend does not support the problem or has no direct solver for it.
NewtonDecrement MeasureNewtonDecrement(const AdjustmentProblem& problem,
                                       const SolveOptions& options);

}  // namespace bundle
