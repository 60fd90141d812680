#pragma once

/// Passes over the edges or the poses of a pose graph, several at a time, compiled once for each
/// instruction set (edge_lanes.cpp).
///
/// The results of an edge or a pose do not depend on those that are computed with it: any division
/// of a pass gives the same bits.

#include <cstdint>

#include "core/pose_graph/relative_pose.h"

namespace bundle {

/// Arrays of a pass: records of poses and measurements, and roots (pose_graph.h).
struct EdgeArrays {
  PoseError error;
  const int32_t* ends;         ///< num_edges x 2
  const double* poses;         ///< num_poses x kRecord
  const double* measurements;  ///< num_edges x kRecord
  const double* roots;         ///< num_edges x RootSize
};

template <typename Group>
struct EdgeKernels {
  /// EdgeTerms<Group>::kNumbers values of each edge in edges[0 ... count).
  void (*linearize)(const EdgeArrays& arrays, const int64_t* edges, int64_t count, double* terms);
  /// ||r~||^2 of each, without the loss.
  void (*chi2)(const EdgeArrays& arrays, const int64_t* edges, int64_t count, double* chi2);
  /// The record of each pose.
  void (*records)(const double* poses, int64_t count, double* records);
};

/// The kernels of the best instruction set that the machine has and BUNDLE_INSTRUCTION_SET allows.
template <typename Group>
const EdgeKernels<Group>& SelectEdgeKernels();

}  // namespace bundle
