#include "core/symbolic/orderings.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <random>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "core/error.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/factor_counts.h"
#include "symbolic/graphs.h"

namespace bundle {
namespace {

constexpr OrderingMethod kMethods[] = {OrderingMethod::kNatural,    OrderingMethod::kReverse,
                                       OrderingMethod::kAmd,        OrderingMethod::kColamd,
                                       OrderingMethod::kMetis,      OrderingMethod::kNesdis,
                                       OrderingMethod::kMinimumFill};

class Orderings : public testing::TestWithParam<OrderingMethod> {};

INSTANTIATE_TEST_SUITE_P(Symbolic, Orderings, testing::ValuesIn(kMethods),
                         [](const auto& test) { return OrderingName(test.param); });

TEST_P(Orderings, ArePermutations) {
  for (const double density : {0., 0.01, 0.1, 0.6, 1.}) {
    for (const int num_blocks : {0, 1, 2, 3, 40, 300}) {
      const BlockPattern pattern = RandomPattern(num_blocks, 4, density, 5);
      EXPECT_NO_THROW(CheckOrder(FindOrder(pattern, GetParam()), num_blocks))
          << num_blocks << " blocks, density " << density;
    }
  }
}

TEST_P(Orderings, AreFoundByTheirNames) {
  EXPECT_EQ(OrderingFromName(OrderingName(GetParam())), GetParam());
}

TEST(Orderings, RefuseOtherNames) {
  try {
    OrderingFromName("AMD");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_EQ(
        std::string(error.what()),
        "ordering: expected one of natural, reverse, amd, colamd, metis, nesdis, minimum_fill, "
        "found AMD");
  }
}

TEST(Orderings, OfAGrid) {
  const BlockPattern grid = Grid(40);
  const auto flops = [&](OrderingMethod method) {
    return CountFactor(grid, FindOrder(grid, method)).flops;
  };
  const double natural = flops(OrderingMethod::kNatural);
  EXPECT_EQ(flops(OrderingMethod::kReverse), natural);  // the grid turned round
  for (const OrderingMethod method :
       {OrderingMethod::kAmd, OrderingMethod::kColamd, OrderingMethod::kMetis,
        OrderingMethod::kNesdis, OrderingMethod::kMinimumFill}) {
    EXPECT_LT(flops(method), 0.4 * natural) << OrderingName(method);
  }
}

/// Blocks left without an edge among the neighbours of a block, twice.
int64_t TwiceFill(const std::vector<std::set<int>>& neighbours, int block) {
  int64_t missing = 0;
  for (const int a : neighbours[block]) {
    for (const int b : neighbours[block]) missing += a != b && neighbours[a].count(b) == 0 ? 1 : 0;
  }
  return missing;
}

TEST(Orderings, ByFillEliminateTheBlockOfLeastFill) {
  for (const double density : {0.05, 0.2, 0.5}) {
    const BlockPattern pattern = RandomPattern(130, 3, density, 11);
    std::vector<std::set<int>> neighbours(130);
    for (int j = 0; j < 130; ++j) {
      for (int64_t e = pattern.column_begin[j] + 1; e < pattern.column_begin[j + 1]; ++e) {
        neighbours[j].insert(pattern.row[e]);
        neighbours[pattern.row[e]].insert(j);
      }
    }
    std::set<int> left;
    for (int j = 0; j < 130; ++j) left.insert(j);
    for (const int block : FindOrder(pattern, OrderingMethod::kMinimumFill)) {
      const auto rank = [&](int j) {
        return std::make_tuple(TwiceFill(neighbours, j), neighbours[j].size(), j);
      };
      for (const int other : left) EXPECT_LE(rank(block), rank(other)) << density;
      left.erase(block);
      for (const int a : neighbours[block]) {
        neighbours[a].insert(neighbours[block].begin(), neighbours[block].end());
        neighbours[a].erase(a);
        neighbours[a].erase(block);
      }
    }
  }
}

/// Images of an orbit, of which each point has ten among the nearest sixty.
TEST(Orderings, ByFillOfOverlappingCliquesSaveFlops) {
  std::mt19937 random(3);
  std::vector<Edge> edges;
  for (int p = 0; p < 3000; ++p) {
    const int first = std::uniform_int_distribution<int>(0, 299)(random);
    std::set<int> images;
    while (images.size() < 10) {
      images.insert((first + std::uniform_int_distribution<int>(0, 59)(random)) % 300);
    }
    for (const int a : images) {
      for (const int b : images) {
        if (a < b) edges.emplace_back(a, b);
      }
    }
  }
  const BlockPattern pattern = PatternOfEdges(std::vector<int>(300, 9), edges);
  const auto flops = [&](OrderingMethod method) {
    return CountFactor(pattern, FindOrder(pattern, method)).flops;
  };
  EXPECT_LT(flops(OrderingMethod::kMinimumFill), 0.95 * flops(OrderingMethod::kAmd));
}

/// Where minimum fill would take long, it gives way to AMD.
TEST(Orderings, ByFillOfALargeGraphAreThoseOfAmd) {
  const BlockPattern grid = Grid(50);
  EXPECT_FALSE(IsFastByFill(grid));
  EXPECT_EQ(FindOrder(grid, OrderingMethod::kMinimumFill), FindOrder(grid, OrderingMethod::kAmd));
}

/// A tree has an order without fill, and minimum degree finds it: of A^T A, were COLAMD given the
/// adjacency matrix itself, it would not.
TEST(Orderings, ByDegreeFillNoTree) {
  std::vector<Edge> edges;
  for (int i = 1; i < 200; ++i) edges.emplace_back(i, (i * 7) % i);
  const BlockPattern tree = PatternOfEdges(std::vector<int>(200, 1), edges);
  EXPECT_EQ(CountFactor(tree, FindOrder(tree, OrderingMethod::kAmd)).fill_edges, 0);
  EXPECT_EQ(CountFactor(tree, FindOrder(tree, OrderingMethod::kColamd)).fill_edges, 0);
}

TEST(Orderings, OfManyPointsAreToldInTheirNumbers) {
  // 20 cameras, each point seen by two neighbours; enough points to be sorted.
  const int num_points = 25000, num_cameras = 20;
  std::vector<Edge> edges;
  for (int p = 0; p < num_points; ++p) {
    const int camera = (p * 7919) % (num_cameras - 1);
    edges.emplace_back(p, num_points + camera);
    edges.emplace_back(p, num_points + camera + 1);
  }
  const BlockPattern pattern = PatternOfEdges(std::vector<int>(num_points + num_cameras, 1), edges);
  for (const OrderingMethod method : {OrderingMethod::kAmd, OrderingMethod::kColamd}) {
    const std::vector<int> order = FindOrder(pattern, method);
    ASSERT_NO_THROW(CheckOrder(order, num_points + num_cameras));
    // Points first leaves a chain of cameras.
    EXPECT_EQ(CountFactor(pattern, order).fill_edges, num_cameras - 1) << OrderingName(method);
  }
}

TEST(Orderings, OfANearlyFullGraphAreAmds) {
  const BlockPattern pattern = RandomPattern(50, 1, 0.9, 3);
  ASSERT_TRUE(IsNearlyFull(pattern));
  const std::vector<int> amd = FindOrder(pattern, OrderingMethod::kAmd);
  EXPECT_EQ(FindOrder(pattern, OrderingMethod::kMetis), amd);
  EXPECT_EQ(FindOrder(pattern, OrderingMethod::kNesdis), amd);
  EXPECT_FALSE(IsNearlyFull(Grid(6)));
}

std::string WhatIsWrongWith(const std::vector<int>& order, int num_blocks) {
  try {
    CheckOrder(order, num_blocks);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(CheckOrder, NamesTheBlock) {
  EXPECT_EQ(WhatIsWrongWith({2, 0, 1}, 3), "");
  EXPECT_EQ(WhatIsWrongWith({0, 1}, 3), "order: expected 3 blocks, found 2");
  EXPECT_EQ(WhatIsWrongWith({0, 1, 3}, 3),
            "order: expected each of the blocks 0 to 2 once, found 3");
  EXPECT_EQ(WhatIsWrongWith({0, -1, 1}, 3),
            "order: expected each of the blocks 0 to 2 once, found -1");
  EXPECT_EQ(WhatIsWrongWith({0, 1, 0}, 3),
            "order: expected each of the blocks 0 to 2 once, found 0 twice");
}

}  // namespace
}  // namespace bundle
