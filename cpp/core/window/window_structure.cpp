#include "core/window/window_structure.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"

namespace bundle {
namespace {

/// From this number of columns on, a sparse factorisation is faster.
constexpr int kColumnsOfDenseWindow = 400;

/// Pairs of blocks that share rows, each pair once.
std::vector<std::pair<int, int>> CoupledPairs(const WindowView& view,
                                              const std::vector<int>& sizes) {
  std::vector<std::pair<int, int>> pairs;
  const auto couple = [&](const std::vector<int>& blocks) {
    for (size_t a = 0; a < blocks.size(); ++a) {
      for (size_t b = a + 1; b < blocks.size(); ++b) {
        if (blocks[a] != blocks[b] && sizes[blocks[a]] > 0 && sizes[blocks[b]] > 0) {
          pairs.emplace_back(std::minmax(blocks[a], blocks[b]));
        }
      }
    }
  };
  for (size_t i = 0; i < view.imu.size(); ++i) {
    const int first = 2 * static_cast<int>(i);
    if (view.imu[i] != nullptr) couple({first, first + 1, first + 2, first + 3});
  }
  for (int k = 0; k < view.num_observations;) {
    const int l = view.landmarks[k];
    std::vector<int> seen = {2 * view.anchor_states[l], view.camera_block(), view.time_block()};
    for (; k < view.num_observations && view.landmarks[k] == l; ++k) {
      seen.push_back(2 * view.observers[k]);
    }
    std::sort(seen.begin(), seen.end());
    seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
    couple(seen);
  }
  for (const WindowPrior& prior : view.priors) couple(prior.blocks);
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

}  // namespace

WindowStructure MakeWindowStructure(const WindowView& view) {
  WindowStructure result;
  std::vector<int> sizes(view.num_blocks()), free, free_sizes;
  result.place.assign(view.num_blocks(), -1);
  for (int b = 0; b < view.num_blocks(); ++b) {
    sizes[b] = view.BlockSize(b);
    if (sizes[b] == 0) continue;
    result.place[b] = static_cast<int>(free.size());
    free.push_back(b);
    free_sizes.push_back(sizes[b]);
  }
  const int columns = std::accumulate(free_sizes.begin(), free_sizes.end(), 0);
  if (columns < kColumnsOfDenseWindow) {
    result.structure = DenseStructure(free_sizes);
    result.solver = MakeDenseSolver(result.structure, 1);
    return result;
  }
  std::vector<std::vector<int>> below(free.size());
  for (size_t k = 0; k < free.size(); ++k) below[k].push_back(static_cast<int>(k));
  for (const auto& [a, b] : CoupledPairs(view, sizes)) {
    below[result.place[a]].push_back(result.place[b]);
  }
  const BlockStructure natural = SparseStructure(free_sizes, below);
  const FillOrdering ordering = FindFillOrdering(natural);
  double entries = 0;
  for (size_t k = 0; k < free.size(); ++k) {
    for (const int row : below[k]) {
      const double size = free_sizes[k];
      entries += row == static_cast<int>(k) ? size * (size + 1) / 2 : size * free_sizes[row];
    }
  }
  result.fill_ratio = ordering.entries / entries;
  result.structure = Reorder(natural, ordering.order);
  for (size_t k = 0; k < free.size(); ++k) {
    result.place[free[ordering.order[k]]] = static_cast<int>(k);
  }
  result.solver = MakeSparseSolver(ordering, 1, &result.structure);
  return result;
}

}  // namespace bundle
