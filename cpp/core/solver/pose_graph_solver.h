#pragma once

#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/fill_ordering.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct PoseGraphOutput : SolveRecord {
  std::vector<double> poses;        ///< constant poses unchanged, all others normalised
  std::vector<double> chi2_before;  ///< r^T Omega r of each edge, without the loss
  std::vector<double> chi2_after;
  std::vector<double> weights;  ///< weight of each edge under the loss, at the end
};

/// Minimises 1/2 sum rho(||r||^2) over the edges of a pose graph. Uses these options: backend,
/// trust region, stopping rules, and threads. `ordering` is that of the fused backend: "auto",
/// "natural", "amd" or "metis"; `known` as in PatternOfEdges. All poses that are not held are free.
/// In a component without a held pose, only the damping makes the normal equations regular.
/// `with_trials`: MinimizePoseGraph in the fused backend. `chi2`: r^T Omega r of each edge at the
/// start, if it is known.
///
/// Throws InputError if the graph's arrays contradict each other (MakePoseGraph), or if the Ceres
/// backend is used with a loss that factors do not have.
PoseGraphOutput SolvePoseGraph(const PoseGraphView& view, const PoseErrorOptions& errors,
                               const SolveOptions& options, const std::string& ordering,
                               const ProgressCallback& progress,
                               const FillOrdering* known = nullptr, bool with_trials = false,
                               const double* chi2 = nullptr);

}  // namespace bundle
