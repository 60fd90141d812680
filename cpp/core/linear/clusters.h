#pragma once

/// Clusters of strongly coupled blocks of S, for the coarse space (derived in clusters.cpp).

#include <Eigen/Core>
#include <vector>

#include "core/linear/block_structure.h"

namespace bundle {

/// Groups strongly coupled blocks into clusters of at most `max_size` blocks. Returns the cluster
/// of every block, from 0 on. Blocks marked in `alone` are clusters of their own. `values` are the
/// values of S.
std::vector<int> ClusterBlocks(const BlockStructure& structure, const BlockValues& values,
                               const std::vector<char>& alone, int max_size);

/// Columns of Q (coarse_space.cpp) on the rows of a cluster's blocks, one block after the other.
struct ClusterDirections {
  Eigen::MatrixXd q;
  std::vector<char> is_idle;  ///< per column: it depends on earlier columns, and is zero
};

/// True if a similarity changes an unknown of a block. `moves`: one entry per column of S.
bool MovesBlock(const BlockStructure& structure, const std::vector<char>& moves, int block);

/// Returns `num_columns` directions: the gauge directions, if they move blocks of the cluster, and
/// one direction per k, which changes the k-th intrinsic of every block. `blocks`: the cluster's
/// blocks.
ClusterDirections FindClusterDirections(const BlockStructure& structure, const BlockSystem& system,
                                        const std::vector<char>& moves,
                                        const std::vector<int>& blocks, int num_columns);

}  // namespace bundle
