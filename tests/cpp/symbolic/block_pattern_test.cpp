#include "core/symbolic/block_pattern.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/error.h"
#include "symbolic/graphs.h"

namespace bundle {
namespace {

std::string WhatIsWrongWith(const BlockPattern& pattern) {
  try {
    CheckBlockPattern(pattern);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(BlockPattern, KeepsItsForm) {
  EXPECT_EQ(WhatIsWrongWith({}), "");
  for (unsigned seed = 0; seed < 10; ++seed) {
    const BlockPattern pattern = RandomPattern(20, 4, 0.1 * seed, seed);
    EXPECT_EQ(WhatIsWrongWith(pattern), "");
    const std::vector<int> blocks = ShuffledOrder(20, seed);
    std::vector<int> sizes;
    for (const int block : blocks) sizes.push_back(pattern.size[block]);
    const BlockPattern permuted = PatternOfRows(PermuteRows(pattern, blocks), sizes);
    EXPECT_EQ(WhatIsWrongWith(permuted), "");
    EXPECT_EQ(NumNonzeros(permuted), NumNonzeros(pattern));
    EXPECT_EQ(NumColumns(permuted), NumColumns(pattern));
  }
}

TEST(BlockPattern, CountsBothTrianglesAndTheDiagonal) {
  const BlockPattern pattern = PatternOfEdges({6, 6, 3}, {{0, 1}, {2, 0}});
  EXPECT_EQ(NumColumns(pattern), 15);
  EXPECT_EQ(NumNonzeros(pattern), 36 + 36 + 9 + 2 * 36 + 2 * 18);
  const BlockPatternView view = pattern;
  EXPECT_EQ(view.num_entries(), 5);
  EXPECT_EQ(view.num_edges(), 2);
  EXPECT_EQ(BlockPatternView(BlockPattern{}).num_edges(), 0);
}

TEST(CheckBlockPattern, NamesWhatIsWrong) {
  EXPECT_EQ(WhatIsWrongWith({{1, 0}, {0, 1, 2}, {0, 1}}),
            "block 1: expected a size of at least 1, found 0");
  EXPECT_EQ(WhatIsWrongWith({{1, -6}, {0, 1, 2}, {0, 1}}),
            "block 1: expected a size of at least 1, found -6");
  EXPECT_EQ(WhatIsWrongWith({{}, {1}, {0}}),
            "block columns: expected the first to begin at 0, found 1");
  EXPECT_EQ(WhatIsWrongWith({{1, 1, 1}, {0, 2, 1, 3}, {0, 1, 2}}),
            "block column 1: expected to end at 2 or later, found 1");
  EXPECT_EQ(
      WhatIsWrongWith({{1, 1}, {0, 1, 1}, {0}}),
      "block column 1: expected the diagonal block as its first entry, found an empty column");
  EXPECT_EQ(WhatIsWrongWith({{1, 1}, {0, 1, 2}, {0, 0}}),
            "block column 1: expected the diagonal block as its first entry, found row 0");
  EXPECT_EQ(WhatIsWrongWith({{1, 1}, {0, 2, 3}, {0, 0, 1}}),  // a loop at 0
            "block column 0: expected ascending rows, found 0 after 0");
  EXPECT_EQ(WhatIsWrongWith({{1, 1}, {0, 3, 4}, {0, 1, 1, 1}}),  // an edge twice
            "block column 0: expected ascending rows, found 1 after 1");
  EXPECT_EQ(WhatIsWrongWith({{1, 1}, {0, 2, 3}, {0, 2, 1}}),
            "block column 0: expected rows below 2, found 2");
}

}  // namespace
}  // namespace bundle
