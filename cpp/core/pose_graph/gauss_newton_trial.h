#pragma once

#include "core/interface/options.h"
#include "core/minimize/trust_region.h"
#include "core/pose_graph/pose_graph_problem.h"

namespace bundle {

/// Minimize (trust_region.h) of a pose graph. If the radius is so large that steps are those of
/// Gauss-Newton, the first rejected step starts a trial (gauss_newton_trial.cpp).
MinimizerSummary MinimizePoseGraph(const SolveOptions& options, const ProgressCallback& progress,
                                   PoseGraphProblem* problem);

}  // namespace bundle
