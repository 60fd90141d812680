#pragma once

#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/solve/summary.h"

namespace bundle {

/// Ceres' summary in our words. `fixed_cost` is the cost of observations that Ceres never saw; it
/// is added to every cost.
SolveSummary Summarize(const ceres::Solver::Summary& summary, double fixed_cost);

/// A warning for each choice of a linear solver or of its preconditioner that Ceres did not keep.
std::vector<Warning> FindFallbacks(const ceres::Solver::Summary& summary);

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost);

}  // namespace bundle
