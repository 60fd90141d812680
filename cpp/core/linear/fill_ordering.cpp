#include "core/linear/fill_ordering.h"

#include <new>
#include <utility>

#include "core/symbolic/factor_counts.h"
#include "core/symbolic/orderings.h"

namespace bundle {

namespace {

FillOrdering Analyze(const BlockPatternView& pattern, const std::string& name,
                     const std::vector<int>& order) {
  const FactorCounts counts = CountFactor(pattern, order);
  FillOrdering result;
  result.name = name;
  result.entries = counts.entries;
  result.flops = counts.cholmod_flops;
  result.elimination_flops = counts.flops;
  result.order.reserve(order.size());
  for (const int k : counts.postorder) result.order.push_back(order[k]);
  return result;
}

std::vector<int> BlockSizes(const BlockStructure& structure) {
  std::vector<int> sizes(structure.num_blocks());
  for (int j = 0; j < structure.num_blocks(); ++j) sizes[j] = structure.block_size(j);
  return sizes;
}

BlockPatternView ViewPattern(const BlockStructure& structure, const std::vector<int>& sizes) {
  return {structure.num_blocks(), sizes.data(), structure.column_begin.data(),
          structure.row_block.data()};
}

}  // namespace

FillOrdering FindFillOrdering(const BlockStructure& structure, const std::string& method) {
  const std::vector<int> sizes = BlockSizes(structure);
  const BlockPatternView pattern = ViewPattern(structure, sizes);
  const std::vector<int> order = FindOrder(pattern, OrderingFromName(method));
  if (order.empty() && structure.num_blocks() > 0) throw std::bad_alloc();
  return Analyze(pattern, method, order);
}

FillOrdering FindFillOrdering(const BlockStructure& structure) {
  const std::vector<int> sizes = BlockSizes(structure);
  const BlockPatternView pattern = ViewPattern(structure, sizes);
  FillOrdering best = Analyze(pattern, "natural", FindOrder(pattern, OrderingMethod::kNatural));
  if (structure.num_blocks() < 3) return best;

  const auto compete = [&](OrderingMethod method) {
    const std::vector<int> order = FindOrder(pattern, method);
    if (order.empty()) return;
    FillOrdering candidate = Analyze(pattern, OrderingName(method), order);
    if (candidate.flops < best.flops) best = std::move(candidate);
  };
  compete(OrderingMethod::kAmd);
  if (!IsNearlyFull(pattern)) compete(OrderingMethod::kMetis);
  return best;
}

FillOrdering TryMinimumFill(const BlockStructure& structure, FillOrdering known) {
  const std::vector<int> sizes = BlockSizes(structure);
  const BlockPatternView pattern = ViewPattern(structure, sizes);
  if (!IsFastByFill(pattern)) return known;
  constexpr OrderingMethod kMethod = OrderingMethod::kMinimumFill;
  FillOrdering found = Analyze(pattern, OrderingName(kMethod), FindOrder(pattern, kMethod));
  return found.flops < known.flops ? found : known;
}

}  // namespace bundle
