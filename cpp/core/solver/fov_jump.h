#pragma once

/// Restarts of a solve across the discontinuity of COLMAP's FOV model (model/fov_lenses.h).
///
/// A lens that starts within kNearJump is not refined through the discontinuity, and a lens that
/// ends a solve there does not stay at it. Its omega becomes 0, and the solve continues to the best
/// pinhole. From there, it continues with an omega on the side that lowers the cost. The solution
/// is the best of all these states, no worse than the pinhole.
///
/// For the caller this is one solve. Its iterations are those that led to the solution; its times
/// and counts are totals.

#include <functional>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

using SolveOnce = std::function<SolveOutput(const AdjustmentProblem&, const SolveOptions&,
                                            const ProgressCallback&)>;

/// Solves a problem by `solve`: once if `lenses` (FindFreeFovLenses) is empty, otherwise as often
/// as necessary.
SolveOutput SolveBeyondFovJump(const AdjustmentProblem& problem, const std::vector<int>& lenses,
                               const SolveOptions& options, const ProgressCallback& progress,
                               const SolveOnce& solve);

}  // namespace bundle
