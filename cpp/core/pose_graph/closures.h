#pragma once

/// Odometry and closures of a pose graph, by the ids of its poses.
///
/// Odometry joins poses that follow each other in the order of ids. Ids may have gaps: those of
/// keyframes, time stamps, or files without some of their poses. All other edges are closures. Keys
/// of GTSAM (a letter in the upper 8 bits, a number in the others) are ids of several trajectories:
/// an edge between two letters is a closure. Other ids of several trajectories have no mark: an
/// edge from the last pose of one to the first pose of the next counts as odometry.

#include <cstdint>
#include <vector>

namespace bundle {

/// Positions of the poses in ascending order of ids, and the inverse permutation.
struct IdOrder {
  std::vector<int32_t> pose;
  std::vector<int32_t> rank;
};
IdOrder OrderOfIds(int64_t num_poses, const int64_t* ids);

/// True for a closure between two poses.
bool IsClosure(const IdOrder& order, const int64_t* ids, int32_t first, int32_t second);

}  // namespace bundle
