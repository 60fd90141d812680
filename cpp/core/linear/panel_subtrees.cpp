#include "core/linear/panel_subtrees.h"

/// A panel updates only panels on its path to the root, so that disjoint subtrees of the tree of
/// panels are independent. If panels are in a postorder, a subtree is a range of panels, its root
/// the last one. In any other order, the factor is one subtree here.
///
/// Panels whose subtrees take more than a part of all flops are the top. What is left are subtrees
/// without a common panel. Neighbouring ones share a range while they are small. The division
/// follows from the factor alone, not from the threads: the order of updates, and with it all bits,
/// are the same for any number of threads.

#include <algorithm>
#include <cstdint>
#include <numeric>

namespace bundle {
namespace {

/// A factor of fewer flops is one subtree, too: waking a thread takes as long as a part of it.
constexpr double kFlopsWorthDividing = 1e6;
constexpr double kLargestPart = 1.0 / 16;

/// Flops of the columns of a panel, and of all that they subtract from later columns.
double FlopsOfPanel(double height, double width) {
  return width * height * height - width * width * height + width * width * width / 3;
}

}  // namespace

PanelSubtrees FindSubtrees(const Supernodes& supernodes, const std::vector<int>& parent,
                           const std::vector<int>& width) {
  const int num_panels = supernodes.num_panels();
  std::vector<double> flops(num_panels, 0.0);  // of the subtree
  std::vector<int> size(num_panels, 1);        // panels of the subtree
  std::vector<int> least(num_panels);          // its first panel
  std::iota(least.begin(), least.end(), 0);
  double total = 0;
  bool is_postorder = true;
  for (int s = 0; s < num_panels; ++s) {
    const double own = FlopsOfPanel(supernodes.height[s], width[s]);
    total += own;
    flops[s] += own;
    is_postorder = is_postorder && least[s] == s + 1 - size[s];
    if (parent[s] < 0) continue;
    flops[parent[s]] += flops[s];
    size[parent[s]] += size[s];
    least[parent[s]] = std::min(least[parent[s]], least[s]);
  }
  if (!is_postorder || total < kFlopsWorthDividing) return {{{0, num_panels}}, {0}, {}};
  const double most = kLargestPart * total;
  PanelSubtrees result;
  std::vector<double> flops_of_range;
  for (int s = 0; s < num_panels; ++s) {
    if (flops[s] > most) {
      result.top.push_back(s);
      continue;
    }
    if (parent[s] >= 0 && flops[parent[s]] <= most) continue;
    const int first = s + 1 - size[s];
    if (!result.subtrees.empty() && result.subtrees.back().last == first &&
        flops_of_range.back() + flops[s] <= most) {
      result.subtrees.back().last = s + 1;
      flops_of_range.back() += flops[s];
    } else {
      result.subtrees.push_back({first, s + 1});
      flops_of_range.push_back(flops[s]);
    }
  }
  result.order.resize(result.subtrees.size());
  std::iota(result.order.begin(), result.order.end(), 0);
  std::stable_sort(result.order.begin(), result.order.end(),
                   [&](int a, int b) { return flops_of_range[a] > flops_of_range[b]; });
  return result;
}

PanelSubtrees FindSubtrees(const Supernodes& supernodes, const std::vector<int>& offset) {
  const std::vector<int> panel_of = PanelOfBlocks(supernodes);
  const int num_panels = supernodes.num_panels();
  std::vector<int> parent(num_panels, -1), width(num_panels);
  for (int s = 0; s < num_panels; ++s) {
    width[s] = offset[supernodes.first_block[s + 1]] - offset[supernodes.first_block[s]];
    const int64_t row = supernodes.rows_begin[s];
    if (row < supernodes.rows_begin[s + 1]) parent[s] = panel_of[supernodes.row_block[row]];
  }
  return FindSubtrees(supernodes, parent, width);
}

}  // namespace bundle
