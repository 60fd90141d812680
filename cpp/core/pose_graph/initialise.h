#pragma once

/// Initial poses of a pose graph, from its edges alone.
///
/// Odometry and spanning tree compose measurements along a path from a held pose: the chain in the
/// order of ids (closures.h), or a tree with the shortest paths (in edges) from the root.
///
/// Chordal (chordal.cpp) uses all edges, in two linear least-squares problems.

#include <cstdint>
#include <utility>
#include <vector>

#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Constant poses: those of `fixed`, and the first pose of each connected component without one.
/// They remove the gauge: 3 degrees of freedom in 2D, 6 in 3D.
struct HeldPoses {
  std::vector<uint8_t> held;
  int num_components = 0;
  std::vector<int32_t> for_gauge;  ///< held poses in addition to the fixed ones
};
HeldPoses HoldPoses(int64_t num_poses, int64_t num_edges, const int32_t* edges,
                    const uint8_t* fixed);

/// Poses computed from the held ones, breadth first along the edges.
std::vector<double> SpanningTreePoses(const PoseGraph& graph);

/// The edges that are no closures (closures.h), in the order of ids. If several edges join two
/// poses, the first is used. Keeps a reference to the graph.
class Odometry {
 public:
  Odometry(const PoseGraph& graph, const int64_t* ids);

  /// The first two poses, by position, that no edge joins; {-1, -1} if odometry joins all.
  std::pair<int32_t, int32_t> Gap() const;
  /// Poses computed from the held ones. Poses that the chain does not reach do not change.
  std::vector<double> Poses() const;

 private:
  struct Link {
    int32_t from, to;  ///< the lower pose, the upper pose
    int64_t edge;      ///< -1: none
  };

  const PoseGraph& graph_;
  std::vector<Link> chain_;
};

}  // namespace bundle
