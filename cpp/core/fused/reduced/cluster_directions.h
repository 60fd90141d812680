#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// Columns of Q (coarse_space.cpp) on the rows of a cluster's blocks, one block after the other.
struct ClusterDirections {
  Eigen::MatrixXd q;
  std::vector<char> is_idle;  ///< of each column: it depends on those before it, and is zero
};

/// Whether a similarity changes any unknown of a block. `moves`: of each column of S, that one
/// does.
bool MovesBlock(const ReducedStructure& structure, const std::vector<char>& moves, int block);

/// The similarities, if the cluster has blocks that they move, and the k-th intrinsics of all of
/// its blocks, for each k: `num_columns` in all. `blocks`: those of the cluster.
ClusterDirections FindClusterDirections(const ReducedStructure& structure,
                                        const ReducedSystem& system, const std::vector<char>& moves,
                                        const std::vector<int>& blocks, int num_columns);

}  // namespace bundle::fused
