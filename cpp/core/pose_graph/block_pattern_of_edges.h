#pragma once

/// The block pattern of a pose graph's normal equations, in the order of its elimination.

#include <string>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct EdgePattern {
  BlockStructure structure;   ///< one block per free pose, in the order of the elimination
  FillOrdering ordering;      ///< cost of the elimination; `order` refers to free poses
  std::vector<int> block_of;  ///< block per pose; -1: the pose is constant
  std::vector<int> pose_of;   ///< pose per block
};

/// The ordering of PatternOfEdges, without the pattern.
FillOrdering OrderEdges(const PoseGraph& graph, int block_size, const std::string& ordering);

/// `ordering`: "natural", "amd", "metis", or "auto". "auto" is AMD or, if a factorisation takes
/// long, the cheapest ordering. `known`: the ordering of an earlier pattern with the same edges and
/// constant poses, whose blocks may have another size; nullptr: it is computed.
EdgePattern PatternOfEdges(const PoseGraph& graph, int block_size, const std::string& ordering,
                           const FillOrdering* known = nullptr);

}  // namespace bundle
