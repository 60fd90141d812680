#include <cholmod.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_solver.h"
#include "fused/reduced/random_system.h"

namespace bundle::fused {
namespace {

using Status = ReducedSolution::Status;

struct Solver {
  ReducedStructure structure;
  std::unique_ptr<ReducedSolver> solver;
};

/// The blocks are eliminated as they come.
Solver MakeSolver(bool dense, const RandomSystem& system, int num_threads = 2) {
  Solver result;
  if (dense) {
    result.structure = DenseStructure(system.sizes);
    result.solver = MakeDenseSolver(result.structure, num_threads);
    return result;
  }
  result.structure = SparseStructure(system.sizes, system.columns);
  std::vector<int> order(system.sizes.size());
  std::iota(order.begin(), order.end(), 0);
  const FillOrdering ordering = AnalyzeOrdering(result.structure, "natural", order);
  result.solver = MakeSparseSolver(ordering, num_threads, &result.structure);
  return result;
}

class DirectSolvers : public testing::TestWithParam<bool> {};

INSTANTIATE_TEST_SUITE_P(Reduced, DirectSolvers, testing::Bool(), [](const auto& test) {
  return std::string(test.param ? "Dense" : "Sparse");
});

void ExpectSolves(Solver* solver, const RandomSystem& system) {
  ReducedSystem stored = Store(system, solver->structure);
  Eigen::VectorXd x(system.num_columns());
  const ReducedSolution solution = solver->solver->Solve(&stored, system.scale, 0.1, x.data());
  ASSERT_EQ(solution.status, Status::kSuccess) << solution.message;
  EXPECT_EQ(solution.num_iterations, 1);
  const Eigen::VectorXd exact = ExactSolution(system);
  EXPECT_LE((x - exact).norm(), 1e-11 * exact.norm());
}

TEST_P(DirectSolvers, AgreeWithExtendedPrecision) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    const int num_blocks = 1 + static_cast<int>(seed % 12);
    const double coupling = 0.1 * (seed % 7);  // 0: every block on its own
    const RandomSystem system = MakeRandomSystem(RandomSizes(num_blocks, seed), coupling, seed);
    Solver solver = MakeSolver(GetParam(), system);
    SCOPED_TRACE(seed);
    ExpectSolves(&solver, system);
  }
}

TEST_P(DirectSolvers, AgreeWhereTheFactorHasWidePanels) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(50, 5), 0.1, 5);
  Solver solver = MakeSolver(GetParam(), system);
  ExpectSolves(&solver, system);
}

TEST_P(DirectSolvers, SolveSystemsOfOneStructureAgainAndAgain) {
  RandomSystem system = MakeRandomSystem(RandomSizes(15, 7), 0.3, 7);
  Solver solver = MakeSolver(GetParam(), system);
  for (int repeat = 0; repeat < 3; ++repeat) {
    ExpectSolves(&solver, system);
    system.s *= 1.5;
    system.s.diagonal().array() += 0.1;
    system.b.reverseInPlace();
  }
}

TEST_P(DirectSolvers, RecoverFromASystemThatIsNotPositiveDefinite) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(9, 3), 0.4, 3);
  Solver solver = MakeSolver(GetParam(), system);
  for (const double spoilt : {-1e3, 0.0, std::numeric_limits<double>::quiet_NaN()}) {
    RandomSystem bad = system;
    bad.s(5, 5) = spoilt;
    ReducedSystem stored = Store(bad, solver.structure);
    Eigen::VectorXd x(system.num_columns());
    const ReducedSolution solution = solver.solver->Solve(&stored, system.scale, 0.1, x.data());
    EXPECT_EQ(solution.status, Status::kFailure) << spoilt;
    EXPECT_FALSE(solution.message.empty());
    ExpectSolves(&solver, system);
  }
}

TEST_P(DirectSolvers, SolveASystemWithoutBlocks) {
  const RandomSystem system = MakeRandomSystem({}, 0, 0);
  Solver solver = MakeSolver(GetParam(), system);
  ReducedSystem stored = Store(system, solver.structure);
  EXPECT_EQ(solver.solver->Solve(&stored, {}, 0.1, nullptr).status, Status::kSuccess);
}

TEST_P(DirectSolvers, CountAFullFactor) {
  const RandomSystem system = MakeRandomSystem({3, 1, 5, 2}, 1, 11);
  const FactorStatistics statistics = MakeSolver(GetParam(), system).solver->factor_statistics();
  EXPECT_EQ(statistics.entries, 11 * 12 / 2);
  EXPECT_NEAR(statistics.flops, GetParam() ? 11. * 11 * 11 / 3 : 11 * 12 * 23 / 6, 1e-9);
}

/// What CHOLMOD's scalar analysis says of an order of the blocks.
FillOrdering AnalyzeScalars(const ReducedStructure& structure, const std::vector<int>& order) {
  std::vector<int> begin{0}, rows, permutation;
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int c = 0; c < structure.block_size(j); ++c) {
      for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
        const int i = structure.row_block[e];
        for (int r = structure.offset[i]; r < structure.offset[i + 1]; ++r) rows.push_back(r);
      }
      begin.push_back(static_cast<int>(rows.size()));
    }
  }
  for (const int block : order) {
    for (int r = structure.offset[block]; r < structure.offset[block + 1]; ++r) {
      permutation.push_back(r);
    }
  }
  cholmod_common common;
  cholmod_start(&common);
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_GIVEN;
  common.postorder = 0;
  cholmod_sparse matrix = {};
  matrix.nrow = matrix.ncol = structure.num_columns();
  matrix.nzmax = rows.size();
  matrix.p = begin.data();
  matrix.i = rows.data();
  matrix.stype = -1;
  matrix.sorted = matrix.packed = 1;
  cholmod_factor* factor = cholmod_analyze_p(&matrix, permutation.data(), nullptr, 0, &common);
  FillOrdering result;
  result.entries = common.lnz;
  result.flops = common.fl;
  cholmod_free_factor(&factor, &common);
  cholmod_finish(&common);
  return result;
}

TEST(FillOrdering, CountsWhatCholmodCounts) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    const RandomSystem system = MakeRandomSystem(RandomSizes(25, seed), 0.02 * seed, seed);
    const ReducedStructure structure = SparseStructure(system.sizes, system.columns);
    std::vector<int> order(25);
    std::iota(order.begin(), order.end(), 0);
    std::shuffle(order.begin(), order.end(), std::mt19937(seed));
    const FillOrdering shuffled = AnalyzeOrdering(structure, "shuffled", order);
    const FillOrdering best = FindFillOrdering(structure);
    for (const FillOrdering* counted : {&shuffled, &best}) {
      const FillOrdering expected = AnalyzeScalars(structure, counted->order);
      EXPECT_EQ(counted->entries, expected.entries) << counted->name;
      EXPECT_EQ(counted->flops, expected.flops) << counted->name;
    }
    EXPECT_LE(best.flops, shuffled.flops);
  }
}

TEST(FillOrdering, ChoosesTheOrderWithLeastFill) {
  // A star whose centre comes first: only the natural order fills in.
  std::vector<std::vector<int>> star(20);
  for (int j = 0; j < 20; ++j) star[j].push_back(j);
  for (int i = 1; i < 20; ++i) star[0].push_back(i);
  const FillOrdering of_star = FindFillOrdering(SparseStructure(std::vector<int>(20, 2), star));
  EXPECT_NE(of_star.name, "natural");
  EXPECT_EQ(of_star.entries, 19 * (4 + 3) + 3);

  // A chain: no order beats the natural one.
  std::vector<std::vector<int>> chain(20);
  for (int j = 0; j < 20; ++j) chain[j] = j < 19 ? std::vector<int>{j, j + 1} : std::vector<int>{j};
  EXPECT_EQ(FindFillOrdering(SparseStructure(std::vector<int>(20, 2), chain)).name, "natural");

  // A grid: nested dissection and minimum degree both beat the rows' order.
  const int side = 24;
  std::vector<std::vector<int>> grid(side * side);
  for (int j = 0; j < side * side; ++j) {
    grid[j].push_back(j);
    if (j % side < side - 1) grid[j].push_back(j + 1);
    if (j + side < side * side) grid[j].push_back(j + side);
  }
  const ReducedStructure structure = SparseStructure(std::vector<int>(side * side, 1), grid);
  std::vector<int> natural(side * side);
  std::iota(natural.begin(), natural.end(), 0);
  EXPECT_LT(FindFillOrdering(structure).flops,
            0.5 * AnalyzeOrdering(structure, "natural", natural).flops);
}

}  // namespace
}  // namespace bundle::fused
