#include "core/linear/block_structure.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

#include "core/linear/supernodes.h"
#include "linear/random_system.h"

namespace bundle {
namespace {

int64_t CompactSize(const RandomSystem& system) {
  int64_t size = 0;
  for (size_t j = 0; j < system.columns.size(); ++j) {
    for (const int i : system.columns[j]) size += int64_t{system.sizes[i]} * system.sizes[j];
  }
  return size;
}

/// S by its lower triangle.
Eigen::MatrixXd Lower(const BlockStructure& structure, const std::vector<double>& values) {
  const int n = structure.num_columns();
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int i = structure.row_block[e];
      for (int c = 0; c < structure.block_size(j); ++c) {
        for (int r = i == j ? c : 0; r < structure.block_size(i); ++r) {
          matrix(structure.offset[i] + r, structure.offset[j] + c) =
              values[structure.ValueIndex(j, e, r, c)];
        }
      }
    }
  }
  return matrix;
}

Eigen::MatrixXd Lower(const Eigen::MatrixXd& matrix) {
  return matrix.triangularView<Eigen::Lower>();
}

TEST(BlockStructure, CompactOneHasTheBlocksOfSWithoutFill) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(40, 3), 0.1, 3);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const BlockStructure in_factor = PlaceInFactor(structure, FindSupernodes(structure));
  const BlockStructure compact = CompactStructure(in_factor);
  ASSERT_GT(in_factor.num_values, CompactSize(system));  // this one fills in
  EXPECT_EQ(compact.num_values, CompactSize(system));
  EXPECT_EQ(compact.row_block, in_factor.row_block);
  EXPECT_EQ(compact.column_begin, in_factor.column_begin);
}

TEST(BlockStructure, SystemsAddUpThroughTheCompactOne) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    SCOPED_TRACE(seed);
    const RandomSystem system = MakeRandomSystem(RandomSizes(1 + 4 * seed, seed), 0.2, seed);
    const BlockStructure structure = SparseStructure(system.sizes, system.columns);
    const BlockStructure in_factor = PlaceInFactor(structure, FindSupernodes(structure));
    const BlockStructure compact = CompactStructure(in_factor);
    const BlockValues values = Store(system, in_factor).values;
    std::vector<double> sum(compact.num_values, 0.0);
    AddBlocks(in_factor, values.data(), compact, sum.data());
    AddBlocks(in_factor, values.data(), compact, sum.data());
    std::vector<double> back(in_factor.num_values, 0.0);
    AddBlocks(compact, sum.data(), in_factor, back.data());
    EXPECT_EQ(Lower(in_factor, back), Lower(2 * system.s));
  }
}

TEST(BlockStructure, DenseOneTakesTheBlocksOfASparseOne) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(12, 5), 0.3, 5);
  const BlockStructure sparse = SparseStructure(system.sizes, system.columns);
  const BlockStructure dense = DenseStructure(system.sizes);
  std::vector<double> values(dense.num_values, 0.0);
  AddBlocks(sparse, Store(system, sparse).values.data(), dense, values.data());
  EXPECT_EQ(Lower(dense, values), Lower(system.s));
}

TEST(BlockStructure, BlocksThatTheOtherLacksAreNotDropped) {
  const BlockStructure diagonal = SparseStructure({2, 3}, {{0}, {1}});
  const BlockStructure full = SparseStructure({2, 3}, {{0, 1}, {1}});
  const std::vector<double> values(full.num_values, 1.0);
  std::vector<double> sums(diagonal.num_values, 0.0);
  EXPECT_THROW(AddBlocks(full, values.data(), diagonal, sums.data()), std::logic_error);
  const BlockStructure other_sizes = SparseStructure({3, 2}, {{0, 1}, {1}});
  EXPECT_THROW(AddBlocks(full, values.data(), other_sizes, sums.data()), std::logic_error);
}

/// Columns of each panel of a path of blocks, in its natural order.
std::vector<int> PanelsOfPath(int num_blocks, int block_size) {
  std::vector<std::pair<int, int>> pairs;
  for (int k = 1; k < num_blocks; ++k) pairs.emplace_back(k - 1, k);
  const BlockStructure path = StructureOfPairs(num_blocks, block_size, pairs);
  const Supernodes nodes = FindSupernodes(path);
  std::vector<int> columns;
  for (int s = 0; s < nodes.num_panels(); ++s) {
    columns.push_back(path.offset[nodes.first_block[s + 1]] - path.offset[nodes.first_block[s]]);
  }
  return columns;
}

// A panel of k blocks of a path has the rows of the block after it: in the unit of a block, k - 1
// columns have one block of zeros more than the next one has. 5 blocks of 3 have 90 zeros, 55 % of
// their entries, and 90 * 15 products; 6 blocks would have 135 * 18, but for the last panel, which
// has no rows below.
TEST(Supernodes, JoinColumnsInSpiteOfZerosWhileAllStayInTheCache) {
  EXPECT_EQ(PanelsOfPath(30, 3), (std::vector<int>{12, 15, 15, 15, 15, 18}));
  EXPECT_EQ(PanelsOfPath(9, 2), (std::vector<int>{2, 16}));
  EXPECT_EQ(PanelsOfPath(5, 6), (std::vector<int>{12, 18}));
}

TEST(Supernodes, JoinOnlyNarrowColumnsInSpiteOfZerosInLargeFactors) {
  // 2 n - 1 blocks of 9 entries: at most 2^19 in the cache.
  EXPECT_EQ(PanelsOfPath(29127, 3).back(), 18);
  EXPECT_EQ(PanelsOfPath(29128, 3).back(), 9);
  EXPECT_EQ(PanelsOfPath(30000, 3), std::vector<int>(10000, 9));
  EXPECT_EQ(PanelsOfPath(66001, 2)[1], 8);
  EXPECT_EQ(PanelsOfPath(7300, 6)[1], 6);
}

}  // namespace
}  // namespace bundle
