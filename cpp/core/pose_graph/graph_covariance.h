#pragma once

/// Covariances of the poses of a graph, and redundancy of its edges.

#include <cstdint>
#include <utility>
#include <vector>

#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct GraphCovarianceOptions {
  bool inner = false;     ///< apply inner constraints instead of gauge poses (graph_covariance.cpp)
  bool of_edges = false;  ///< compute redundancies and tests, too
  /// Pairs of poses of one component, or of components with a fixed pose.
  std::vector<std::pair<int32_t, int32_t>> relative;
  int num_threads = 1;
};

/// Matrices are row-major, d x d with d = 3 or 6 by tangent coordinates, right perturbations.
struct GraphCovarianceOutput {
  std::vector<double> poses;     ///< num_poses x d x d
  std::vector<double> relative;  ///< pairs x d x d: covariances of X_a^-1 X_b
  std::vector<double> across;    ///< pairs x d x d: covariances of a with b
  /// Per edge, if requested: the redundancy (the part of its d errors that other edges check); r^T
  /// K^+ r with K the covariance of its whitened error; and the rank of K, which is the degrees of
  /// freedom of the test. NaN, NaN and 0 if rounding leaves no digit of K.
  std::vector<double> edge_redundancy, edge_test;
  std::vector<int32_t> edge_rank;
  /// Decrease of the cost by one more step, as predicted by its quadratic model; 0 at a minimum.
  double predicted_decrease = 0;
  /// Largest ratio of a variance to the variance with all other unknowns known: a measure of lost
  /// digits. Infinite if variances are only rounding errors.
  double inflation = 1;
  int32_t undetermined_pose =
      -1;  ///< pose at which the factorisation failed; other outputs are then empty
};

/// Evaluates at the graph's poses. `fixed`: 1 if a pose is known. In a component without a fixed
/// pose, the first pose is held, or inner constraints apply to all. The graph's `held` is not used.
GraphCovarianceOutput ComputeGraphCovariance(PoseGraph graph, const uint8_t* fixed,
                                             const GraphCovarianceOptions& options);

}  // namespace bundle
