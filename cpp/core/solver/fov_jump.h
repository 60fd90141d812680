#pragma once

/// Restarts of a solve across the jump of COLMAP's FOV (model/fov_lenses.h).
///
/// A lens that starts within kNearJump is not refined through the jump, and a lens that ends a
/// solve there does not stay at it. Its omega becomes 0, and the solve continues to the best
/// pinhole, and from there with an omega on the side that lowers the cost. The best of all states
/// on the way is the solution, no worse than the pinhole.
///
/// For the caller this is one solve. Its iterations are those on the way to the solution; its times
/// and counts are totals.

#include <functional>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

using SolveOnce = std::function<SolveOutput(const AdjustmentProblem&, const SolveOptions&,
                                            const ProgressCallback&)>;

/// Solves a problem by `solve`: once where `lenses` (FindFreeFovLenses) is empty, else as often as
/// it takes.
SolveOutput SolveBeyondFovJump(const AdjustmentProblem& problem, const std::vector<int>& lenses,
                               const SolveOptions& options, const ProgressCallback& progress,
                               const SolveOnce& solve);

}  // namespace bundle
