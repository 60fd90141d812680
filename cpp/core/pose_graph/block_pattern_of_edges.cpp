#include "core/pose_graph/block_pattern_of_edges.h"

#include <stdexcept>
#include <utility>

namespace bundle {
namespace {

/// METIS takes some two microseconds per pose, the time of 2e4 flops, and saves at most a third of
/// the flops. With fewer flops per pose with AMD than this, METIS costs more than it saves in the
/// few factorisations of a solve.
constexpr double kFlopsWorthMetis = 3e4;

FillOrdering FindOrdering(const BlockStructure& structure, const std::string& ordering) {
  if (ordering != "auto") return FindFillOrdering(structure, ordering);
  FillOrdering amd = FindFillOrdering(structure, "amd");
  if (amd.flops < kFlopsWorthMetis * structure.num_blocks()) return amd;
  return FindFillOrdering(structure);
}

/// Free poses, and the block of each pose: its number among them, or -1.
std::vector<int> FreePoses(const PoseGraph& graph, std::vector<int>* block_of) {
  block_of->assign(graph.num_poses(), -1);
  std::vector<int> free;
  free.reserve(graph.num_poses());
  for (int64_t i = 0; i < graph.num_poses(); ++i) {
    if (graph.held[i] != 0) continue;
    (*block_of)[i] = static_cast<int>(free.size());
    free.push_back(static_cast<int>(i));
  }
  return free;
}

BlockStructure StructureOfEdges(const PoseGraph& graph, int num_free, int block_size,
                                const std::vector<int>& block_of) {
  std::vector<std::pair<int, int>> pairs;
  pairs.reserve(graph.num_edges());
  for (int64_t e = 0; e < graph.num_edges(); ++e) {
    const int a = block_of[graph.edges()[2 * e]], b = block_of[graph.edges()[2 * e + 1]];
    if (a >= 0 && b >= 0) pairs.emplace_back(a, b);
  }
  return StructureOfPairs(num_free, block_size, pairs);
}

}  // namespace

FillOrdering OrderEdges(const PoseGraph& graph, int block_size, const std::string& ordering) {
  std::vector<int> block_of;
  const auto num_free = static_cast<int>(FreePoses(graph, &block_of).size());
  return FindOrdering(StructureOfEdges(graph, num_free, block_size, block_of), ordering);
}

EdgePattern PatternOfEdges(const PoseGraph& graph, int block_size, const std::string& ordering,
                           const FillOrdering* known) {
  EdgePattern pattern;
  const std::vector<int> free = FreePoses(graph, &pattern.block_of);
  const auto num_free = static_cast<int>(free.size());
  if (known != nullptr && known->order.size() != free.size()) {
    throw std::logic_error("PatternOfEdges: expected an ordering of the same free poses");
  }
  pattern.ordering =
      known != nullptr
          ? *known
          : FindOrdering(StructureOfEdges(graph, num_free, block_size, pattern.block_of), ordering);
  pattern.pose_of.reserve(free.size());
  for (int k = 0; k < num_free; ++k) {
    const int pose = free[pattern.ordering.order[k]];
    pattern.pose_of.push_back(pose);
    pattern.block_of[pose] = k;
  }
  pattern.structure = StructureOfEdges(graph, num_free, block_size, pattern.block_of);
  return pattern;
}

}  // namespace bundle
