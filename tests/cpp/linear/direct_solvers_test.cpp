#include "core/linear/direct_solvers.h"

#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"
#include "core/symbolic/factor_counts.h"
#include "linear/random_system.h"

namespace bundle {
namespace {

using Status = LinearStatus;

struct Solver {
  BlockStructure structure;
  std::unique_ptr<LinearSolver> solver;
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
  FillOrdering ordering;
  ordering.name = "natural";
  ordering.order.resize(system.sizes.size());
  std::iota(ordering.order.begin(), ordering.order.end(), 0);
  const FactorCounts counts =
      CountFactor({result.structure.num_blocks(), system.sizes.data(),
                   result.structure.column_begin.data(), result.structure.row_block.data()},
                  ordering.order);
  ordering.entries = counts.entries;
  ordering.flops = counts.cholmod_flops;
  ordering.elimination_flops = counts.flops;
  result.solver = MakeSparseSolver(ordering, num_threads, &result.structure);
  return result;
}

class DirectSolvers : public testing::TestWithParam<bool> {};

INSTANTIATE_TEST_SUITE_P(Reduced, DirectSolvers, testing::Bool(), [](const auto& test) {
  return std::string(test.param ? "Dense" : "Sparse");
});

void ExpectSolves(Solver* solver, const RandomSystem& system) {
  BlockSystem stored = Store(system, solver->structure);
  Eigen::VectorXd x(system.num_columns());
  const LinearSolution solution = solver->solver->Solve(&stored, system.scale, 0.1, x.data());
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
    BlockSystem stored = Store(bad, solver.structure);
    Eigen::VectorXd x(system.num_columns());
    const LinearSolution solution = solver.solver->Solve(&stored, system.scale, 0.1, x.data());
    EXPECT_EQ(solution.status, Status::kFailure) << spoilt;
    EXPECT_FALSE(solution.message.empty());
    ExpectSolves(&solver, system);
  }
}

TEST_P(DirectSolvers, SolveASystemWithoutBlocks) {
  const RandomSystem system = MakeRandomSystem({}, 0, 0);
  Solver solver = MakeSolver(GetParam(), system);
  BlockSystem stored = Store(system, solver.structure);
  EXPECT_EQ(solver.solver->Solve(&stored, {}, 0.1, nullptr).status, Status::kSuccess);
}

TEST_P(DirectSolvers, CountAFullFactor) {
  const RandomSystem system = MakeRandomSystem({3, 1, 5, 2}, 1, 11);
  const FactorStatistics statistics = MakeSolver(GetParam(), system).solver->factor_statistics();
  EXPECT_EQ(statistics.entries, 11 * 12 / 2);
  EXPECT_EQ(statistics.predicted, statistics.entries);
  EXPECT_EQ(statistics.stored, statistics.entries);
  EXPECT_EQ(statistics.flops, 10 * 11 * 21 / 6 + 3 * 10 * 11 / 2);
}

TEST_P(DirectSolvers, StoreTheFactorThatWasPredicted) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    const int num_blocks = 5 + 4 * static_cast<int>(seed);
    const RandomSystem system = MakeRandomSystem(RandomSizes(num_blocks, seed), 0.05, seed);
    const FactorStatistics statistics = MakeSolver(GetParam(), system).solver->factor_statistics();
    EXPECT_EQ(statistics.entries, statistics.predicted) << seed;
    EXPECT_GE(statistics.stored, statistics.entries) << seed;
    EXPECT_LE(statistics.stored, 1.25 * statistics.entries) << seed;  // zeros: a fifth of the panel
  }
}

}  // namespace
}  // namespace bundle
