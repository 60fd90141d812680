#include "core/linear/supernodal_cholesky.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "core/linear/fill_ordering.h"
#include "core/linear/panel_subtrees.h"
#include "linear/random_system.h"

namespace bundle {
namespace {

/// A grid of blocks of several sizes in a fill-reducing order: a tree of many panels.
struct Grid {
  BlockStructure structure;
  Supernodes supernodes;
  Eigen::MatrixXd s;

  explicit Grid(int side) {
    std::vector<int> sizes = RandomSizes(side * side, 4);
    std::vector<std::vector<int>> columns(side * side);
    for (int j = 0; j < side * side; ++j) {
      columns[j].push_back(j);
      if (j % side + 1 < side) columns[j].push_back(j + 1);
      if (j + side < side * side) columns[j].push_back(j + side);
    }
    const BlockStructure natural = SparseStructure(sizes, columns);
    structure = Reorder(natural, FindFillOrdering(natural, "amd").order);
    supernodes = FindSupernodes(structure);
    structure = PlaceInFactor(structure, supernodes);
    const int n = structure.num_columns();
    s = Eigen::MatrixXd::Zero(n, n);
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    ForBlocks([&](int row, int column, int64_t) {
      if (row >= column) s(row, column) = s(column, row) = normal(random);
    });
    s.diagonal() = s.cwiseAbs().rowwise().sum();
  }

  /// Visits the entries of S's blocks, those above the diagonal of diagonal blocks included.
  template <typename Visit>
  void ForBlocks(const Visit& visit) const {
    for (int j = 0; j < structure.num_blocks(); ++j) {
      for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
        const int i = structure.row_block[e];
        for (int c = 0; c < structure.block_size(j); ++c) {
          for (int r = 0; r < structure.block_size(i); ++r) {
            visit(structure.offset[i] + r, structure.offset[j] + c,
                  structure.ValueIndex(j, e, r, c));
          }
        }
      }
    }
  }

  std::vector<double> Values() const {
    std::vector<double> values(structure.num_values, 0.0);
    ForBlocks([&](int row, int column, int64_t at) {
      values[at] = row >= column ? s(row, column) : std::numeric_limits<double>::quiet_NaN();
    });
    return values;
  }
};

PanelSubtrees SubtreesOf(const Grid& grid) {
  const Supernodes& nodes = grid.supernodes;
  std::vector<int> parent, width, panel_of;
  for (int s = 0; s < nodes.num_panels(); ++s) {
    panel_of.resize(nodes.first_block[s + 1], s);
    width.push_back(grid.structure.offset[nodes.first_block[s + 1]] -
                    grid.structure.offset[nodes.first_block[s]]);
  }
  for (int s = 0; s < nodes.num_panels(); ++s) {
    const bool is_root = nodes.rows_begin[s] == nodes.rows_begin[s + 1];
    parent.push_back(is_root ? -1 : panel_of[nodes.row_block[nodes.rows_begin[s]]]);
  }
  return FindSubtrees(nodes, parent, width);
}

TEST(SupernodalCholesky, SolvesTheSameForAnyNumberOfThreads) {
  const Grid grid(10);
  ASSERT_GT(SubtreesOf(grid).subtrees.size(), 4U);
  ASSERT_GT(SubtreesOf(grid).top.size(), 1U);
  const Eigen::VectorXd b = Eigen::VectorXd::LinSpaced(grid.structure.num_columns(), -1, 2);
  SupernodalCholesky cholesky(grid.structure.offset, grid.supernodes);
  std::vector<double> first;
  for (const int threads : {0, 1, 2, 3, 5}) {
    std::vector<double> values = grid.Values();
    ThreadPool pool(std::max(threads, 1));
    ASSERT_EQ(cholesky.Factorize(values.data(), threads == 0 ? nullptr : &pool), 0);
    std::vector<double> x(b.data(), b.data() + b.size());
    cholesky.Solve(values.data(), x.data());
    const Eigen::Map<const Eigen::VectorXd> found(x.data(), b.size());
    EXPECT_LE((grid.s * found - b).norm(), 1e-13 * b.norm());
    if (first.empty()) first = x;
    EXPECT_EQ(x, first) << threads;
  }
}

TEST(SupernodalCholesky, NamesTheFirstMinorThatFailsForAnyNumberOfThreads) {
  Grid grid(10);
  const int n = grid.structure.num_columns();
  SupernodalCholesky cholesky(grid.structure.offset, grid.supernodes);
  for (const auto& [early, late] : std::vector<std::pair<int, int>>{{5, n - 1}, {n / 2, n - 3}}) {
    Grid bad = grid;
    bad.s(early, early) = bad.s(late, late) = -1;
    for (const int threads : {1, 3}) {
      ThreadPool pool(threads);
      std::vector<double> values = bad.Values();
      EXPECT_EQ(cholesky.Factorize(values.data(), &pool), early + 1);
      values = grid.Values();
      EXPECT_EQ(cholesky.Factorize(values.data(), &pool), 0);
    }
  }
}

TEST(PanelSubtrees, AreEachPanelOnceAndChildrenBeforeParents) {
  const Grid grid(10);
  const PanelSubtrees found = SubtreesOf(grid);
  std::vector<int> times(grid.supernodes.num_panels(), 0);
  for (const PanelRange& range : found.subtrees) {
    for (int s = range.first; s < range.last; ++s) ++times[s];
  }
  for (const int s : found.top) ++times[s];
  EXPECT_EQ(times, std::vector<int>(times.size(), 1));
  EXPECT_EQ(found.order.size(), found.subtrees.size());
  EXPECT_EQ(found.top.back(), grid.supernodes.num_panels() - 1);
}

TEST(PanelSubtrees, AreOneInAnOrderThatIsNoPostorder) {
  // Leaves 0 and 1 of the roots 3 and 2.
  Supernodes nodes;
  nodes.height = {400, 400, 200, 200};
  const PanelSubtrees found = FindSubtrees(nodes, {3, 2, -1, -1}, {200, 200, 200, 200});
  ASSERT_EQ(found.subtrees.size(), 1U);
  EXPECT_EQ(found.subtrees[0].last, 4);
  EXPECT_TRUE(found.top.empty());
  EXPECT_GT(FindSubtrees(nodes, {1, 3, 3, -1}, {200, 200, 200, 200}).top.size(), 1U);
}

}  // namespace
}  // namespace bundle
