#include "core/symbolic/factor_counts.h"

#include <cholmod.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "core/symbolic/block_pattern.h"
#include "symbolic/graphs.h"

namespace bundle {
namespace {

struct ScalarAnalysis {
  double entries = 0;
  double flops = 0;
  std::vector<int> column_counts;  ///< with the diagonal
};

/// CHOLMOD's counts for the scalar matrix with dense blocks, in the order of its blocks.
ScalarAnalysis AnalyzeWithCholmod(const BlockPattern& pattern, const std::vector<int>& order) {
  std::vector<int> offset(1, 0), begin{0}, rows, permutation;
  for (const int size : pattern.size) offset.push_back(offset.back() + size);
  for (size_t j = 0; j < pattern.size.size(); ++j) {
    for (int c = 0; c < pattern.size[j]; ++c) {
      for (int64_t e = pattern.column_begin[j]; e < pattern.column_begin[j + 1]; ++e) {
        const int i = pattern.row[e];
        for (int r = offset[i]; r < offset[i + 1]; ++r) rows.push_back(r);
      }
      begin.push_back(static_cast<int>(rows.size()));
    }
  }
  for (const int block : order) {
    for (int r = offset[block]; r < offset[block + 1]; ++r) permutation.push_back(r);
  }
  cholmod_common common;
  cholmod_start(&common);
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_GIVEN;
  common.postorder = 0;
  common.supernodal = CHOLMOD_SIMPLICIAL;
  cholmod_sparse matrix = {};
  matrix.nrow = matrix.ncol = offset.back();
  matrix.nzmax = rows.size();
  matrix.p = begin.data();
  matrix.i = rows.data();
  matrix.stype = -1;
  matrix.sorted = matrix.packed = 1;
  cholmod_factor* factor = cholmod_analyze_p(&matrix, permutation.data(), nullptr, 0, &common);
  const int* counts = static_cast<const int*>(factor->ColCount);
  ScalarAnalysis result{common.lnz, common.fl, {counts, counts + factor->n}};
  cholmod_free_factor(&factor, &common);
  cholmod_finish(&common);
  return result;
}

/// Counts below the diagonal of each scalar column.
std::vector<int> ScalarCounts(const BlockPattern& pattern, const std::vector<int>& order,
                              const FactorCounts& counts) {
  std::vector<int> result;
  for (size_t k = 0; k < order.size(); ++k) {
    for (int left = pattern.size[order[k]] - 1; left >= 0; --left) {
      result.push_back(static_cast<int>(counts.rows_below[k]) + left);
    }
  }
  return result;
}

TEST(FactorCounts, AreThoseOfCholmod) {
  for (unsigned seed = 0; seed < 60; ++seed) {
    const int num_blocks = 1 + static_cast<int>(seed % 40);
    const BlockPattern pattern = RandomPattern(num_blocks, 5, 0.01 * (seed % 13), seed);
    const std::vector<int> order = ShuffledOrder(num_blocks, seed);
    const FactorCounts counts = CountFactor(pattern, order);
    const ScalarAnalysis expected = AnalyzeWithCholmod(pattern, order);
    SCOPED_TRACE(seed);
    EXPECT_EQ(counts.entries, expected.entries);
    EXPECT_EQ(counts.cholmod_flops, expected.flops);
    double flops = 0;
    std::vector<int> with_diagonal;
    for (const int c : ScalarCounts(pattern, order, counts)) {
      with_diagonal.push_back(c + 1);
      flops += 1. * c * c + 3. * c;
    }
    EXPECT_EQ(with_diagonal, expected.column_counts);
    EXPECT_EQ(counts.flops, flops);
  }
}

/// Eliminates block after block in a full matrix of flags.
struct FullElimination {
  std::vector<std::vector<bool>> flag;  ///< column counts of L, by position
  std::vector<int64_t> blocks_below;
  std::vector<int> parent;
  int64_t fill = 0;

  FullElimination(const BlockPattern& pattern, const std::vector<int>& order)
      : flag(order.size(), std::vector<bool>(order.size())) {
    const int n = static_cast<int>(order.size());
    std::vector<int> position(n);
    for (int k = 0; k < n; ++k) position[order[k]] = k;
    for (int j = 0; j < n; ++j) {
      for (int64_t e = pattern.column_begin[j] + 1; e < pattern.column_begin[j + 1]; ++e) {
        const int a = position[j], b = position[pattern.row[e]];
        flag[std::max(a, b)][std::min(a, b)] = true;
      }
    }
    for (int k = 0; k < n; ++k) Eliminate(k);
  }

 private:
  void Eliminate(int k) {
    std::vector<int> below;
    for (int i = k + 1; i < static_cast<int>(flag.size()); ++i) {
      if (flag[i][k]) below.push_back(i);
    }
    blocks_below.push_back(static_cast<int64_t>(below.size()));
    parent.push_back(below.empty() ? -1 : below.front());
    for (const int j : below) {
      for (const int i : below) {
        if (i <= j || flag[i][j]) continue;
        flag[i][j] = true;
        ++fill;
      }
    }
  }
};

TEST(FactorCounts, AreThoseOfAnEliminationInFull) {
  for (unsigned seed = 0; seed < 40; ++seed) {
    const int num_blocks = static_cast<int>(seed % 30);
    const BlockPattern pattern = RandomPattern(num_blocks, 3, 0.02 * (seed % 9), seed);
    const std::vector<int> order = ShuffledOrder(num_blocks, seed);
    const FactorCounts counts = CountFactor(pattern, order);
    const FullElimination expected(pattern, order);
    SCOPED_TRACE(seed);
    EXPECT_EQ(counts.blocks_below, expected.blocks_below);
    EXPECT_EQ(counts.parent, expected.parent);
    EXPECT_EQ(counts.fill_edges, expected.fill);
    EXPECT_EQ(counts.block_entries,
              std::accumulate(expected.blocks_below.begin(), expected.blocks_below.end(),
                              int64_t{num_blocks}));
  }
}

TEST(FactorCounts, TellTheHeightOfTheTree) {
  EXPECT_EQ(CountFactor(BlockPattern{}, {}).tree_height, 0);
  const BlockPattern apart = RandomPattern(5, 3, 0, 0);
  EXPECT_EQ(CountFactor(apart, ShuffledOrder(5, 1)).tree_height, 1);
  const BlockPattern chain =
      PatternOfEdges(std::vector<int>(7, 2), {{0, 1}, {1, 2}, {2, 3}, {3, 4}, {4, 5}, {5, 6}});
  EXPECT_EQ(CountFactor(chain, {0, 1, 2, 3, 4, 5, 6}).tree_height, 7);
  EXPECT_EQ(CountFactor(chain, {0, 2, 4, 6, 1, 5, 3}).tree_height, 3);  // halved, and halved again
}

TEST(FactorCounts, PostordersTheTree) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    const BlockPattern pattern = RandomPattern(60, 4, 0.004 * seed, seed);
    const std::vector<int> order = ShuffledOrder(60, seed);
    const FactorCounts counts = CountFactor(pattern, order);
    std::vector<int> reordered;
    for (const int k : counts.postorder) reordered.push_back(order[k]);
    const FactorCounts again = CountFactor(pattern, reordered);
    EXPECT_TRUE(IsPostordered(again.parent));
    EXPECT_EQ(again.entries, counts.entries);
    EXPECT_EQ(again.flops, counts.flops);
    EXPECT_EQ(again.tree_height, counts.tree_height);
  }
}

TEST(FactorCounts, CountBlocksTooLargeToList) {
  const int n = 1 << 30;  // a chain of two: 2^31 columns, 2^61 entries
  const FactorCounts counts = CountFactor(PatternOfEdges({n, n}, {{0, 1}}), {0, 1});
  const double columns = 2. * n;
  EXPECT_DOUBLE_EQ(counts.entries, columns * (columns + 1) / 2);
  EXPECT_NEAR(counts.cholmod_flops / (columns * columns * columns / 3), 1, 1e-8);
}

}  // namespace
}  // namespace bundle
