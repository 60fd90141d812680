#include "core/linear/fill_ordering.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/factor_counts.h"
#include "core/symbolic/orderings.h"
#include "symbolic/graphs.h"

namespace bundle {
namespace {

BlockStructure StructureOf(const BlockPattern& pattern) {
  std::vector<std::vector<int>> columns(pattern.size.size());
  for (size_t j = 0; j < columns.size(); ++j) {
    columns[j].assign(pattern.row.begin() + pattern.column_begin[j],
                      pattern.row.begin() + pattern.column_begin[j + 1]);
  }
  return SparseStructure(pattern.size, columns);
}

TEST(FillOrdering, CountsInItsOwnOrder) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    const BlockPattern pattern = RandomPattern(25, 5, 0.02 * seed, seed);
    const FillOrdering best = FindFillOrdering(StructureOf(pattern));
    const FactorCounts counts = CountFactor(pattern, best.order);
    EXPECT_EQ(best.entries, counts.entries);
    EXPECT_EQ(best.flops, counts.cholmod_flops);
    EXPECT_TRUE(IsPostordered(counts.parent));
    for (const OrderingMethod method :
         {OrderingMethod::kNatural, OrderingMethod::kAmd, OrderingMethod::kMetis}) {
      EXPECT_LE(best.flops, CountFactor(pattern, FindOrder(pattern, method)).cholmod_flops);
    }
  }
}

TEST(FillOrdering, ChoosesTheOrderWithLeastFill) {
  // A star whose centre comes first: only the natural order fills in.
  std::vector<Edge> star, chain;
  for (int i = 1; i < 20; ++i) star.emplace_back(0, i);
  for (int i = 1; i < 20; ++i) chain.emplace_back(i - 1, i);
  const std::vector<int> sizes(20, 2);
  const FillOrdering of_star = FindFillOrdering(StructureOf(PatternOfEdges(sizes, star)));
  EXPECT_NE(of_star.name, "natural");
  EXPECT_EQ(of_star.entries, 19 * (4 + 3) + 3);

  // A chain: no order beats the natural one.
  EXPECT_EQ(FindFillOrdering(StructureOf(PatternOfEdges(sizes, chain))).name, "natural");

  // A grid: nested dissection and minimum degree both beat the rows' order.
  const BlockPattern grid = Grid(24);
  const FactorCounts natural = CountFactor(grid, FindOrder(grid, OrderingMethod::kNatural));
  EXPECT_LT(FindFillOrdering(StructureOf(grid)).flops, 0.5 * natural.cholmod_flops);
}

TEST(FillOrdering, TriesMinimumFill) {
  bool is_taken = false;
  for (unsigned seed = 0; seed < 10; ++seed) {
    const BlockPattern pattern = RandomPattern(60, 5, 0.03 * (seed + 1), seed);
    const BlockStructure structure = StructureOf(pattern);
    const FillOrdering known = FindFillOrdering(structure, "amd");
    const FillOrdering best = TryMinimumFill(structure, known);
    const FillOrdering by_fill = FindFillOrdering(structure, "minimum_fill");
    EXPECT_EQ(best.flops, std::min(known.flops, by_fill.flops));
    const FactorCounts counts = CountFactor(pattern, best.order);
    EXPECT_EQ(best.flops, counts.cholmod_flops);
    EXPECT_TRUE(IsPostordered(counts.parent));
    EXPECT_EQ(best.name, by_fill.flops < known.flops ? "minimum_fill" : "amd");
    is_taken = is_taken || best.name == "minimum_fill";
  }
  EXPECT_TRUE(is_taken);
  const BlockStructure large = StructureOf(Grid(50));
  EXPECT_EQ(TryMinimumFill(large, FindFillOrdering(large, "natural")).name, "natural");
}

}  // namespace
}  // namespace bundle
