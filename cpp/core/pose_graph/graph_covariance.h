#pragma once

/// Covariances of the poses of a graph, and redundancy of its edges.

#include <cstdint>
#include <utility>
#include <vector>

#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct GraphCovarianceOptions {
  bool inner = false;     ///< inner constraints for what the gauge holds (graph_covariance.cpp)
  bool of_edges = false;  ///< redundancies and tests, too
  std::vector<std::pair<int32_t, int32_t>> relative;  ///< pairs of poses
  int num_threads = 1;
};

/// Matrices are row-major, d x d with d = 3 or 6 by tangent coordinates, right perturbations.
struct GraphCovarianceOutput {
  std::vector<double> poses;     ///< num_poses x d x d
  std::vector<double> relative;  ///< pairs x d x d: of X_a^-1 X_b
  /// Per edge, if asked for: how much of its d errors the other edges check, r^T K^+ r with K the
  /// covariance of its whitened error, and the rank of K, which is the degrees of freedom of the
  /// test. NaN, NaN and 0 if rounding leaves nothing of K.
  std::vector<double> edge_redundancy, edge_test;
  std::vector<int32_t> edge_rank;
  /// Decrease of the cost by one more step, as predicted by its quadratic model; 0 at a minimum.
  double predicted_decrease = 0;
  /// Largest ratio of a variance to that with all else known: a measure of lost digits. Infinite if
  /// variances are rounding errors alone.
  double inflation = 1;
  int32_t undetermined_pose = -1;  ///< where the factorisation failed; the rest is empty then
};

/// At the graph's poses. `fixed`: 1 where a pose is known; in a component without such a pose the
/// first one is held, or the inner constraints hold all. The graph's `held` is not read.
GraphCovarianceOutput ComputeGraphCovariance(PoseGraph graph, const uint8_t* fixed,
                                             const GraphCovarianceOptions& options);

}  // namespace bundle
