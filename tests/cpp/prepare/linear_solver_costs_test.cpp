#include <gtest/gtest.h>

#include <algorithm>
#include <regex>
#include <string>
#include <vector>

#include "core/parallel/instruction_set.h"
#include "core/prepare/choose_solver.h"

namespace bundle {
namespace {

constexpr double kPlenty = 1e15;

/// Each of num_blocks blocks of 9 coupled with the next `width`.
BlockStructure Band(int num_blocks, int width) {
  std::vector<std::vector<int>> columns(num_blocks);
  for (int j = 0; j < num_blocks; ++j) {
    for (int i = j; i <= std::min(j + width, num_blocks - 1); ++i) columns[j].push_back(i);
  }
  return SparseStructure(std::vector<int>(num_blocks, 9), columns);
}

/// Each of num_blocks blocks coupled with many far away, so that everything fills in.
BlockStructure Scattered(int num_blocks, int couplings) {
  std::vector<std::vector<int>> columns(num_blocks);
  unsigned state = 1;
  for (int j = 0; j < num_blocks; ++j) {
    columns[j].push_back(j);
    for (int k = 0; k < couplings && j + 1 < num_blocks; ++k) {
      state = state * 1664525u + 1013904223u;
      columns[j].push_back(j + 1 + static_cast<int>((state >> 8) % (num_blocks - j - 1)));
    }
    std::sort(columns[j].begin(), columns[j].end());
    columns[j].erase(std::unique(columns[j].begin(), columns[j].end()), columns[j].end());
  }
  return SparseStructure(std::vector<int>(num_blocks, 9), columns);
}

LinearSolverType Choose(const BlockStructure& structure, double available_bytes = kPlenty) {
  return ChooseLinearSolver(structure, FindFillOrdering(structure), 2, available_bytes).type;
}

/// The faster factorisation of a large full system on two cores. BLAS takes 40 GFLOP/s a core; our
/// dense kernels are for AVX-512, our sparse ones take 43 with AVX2.
LinearSolverType FullSystemSolver() {
  return BestInstructionSet() == InstructionSet::kAvx2 ? LinearSolverType::kSparseSchur
                                                       : LinearSolverType::kDenseSchur;
}

LinearSolverCosts Predict(const BlockStructure& structure, int num_threads) {
  return PredictLinearSolverCosts(structure, FindFillOrdering(structure), num_threads);
}

TEST(LinearSolverCost, CountsAFullMatrixTheSameBothWays) {
  const LinearSolverCosts costs = Predict(Band(30, 30), 2);
  EXPECT_NEAR(costs.sparse.flops, costs.dense.flops, 0.01 * costs.dense.flops);
  EXPECT_LT(costs.dense.seconds, costs.sparse.seconds);
}

TEST(LinearSolverCost, OfABandGrowsWithItsLength) {
  const LinearSolverCosts one = Predict(Band(200, 10), 1);
  const LinearSolverCosts four = Predict(Band(800, 10), 1);
  EXPECT_NEAR(four.sparse.seconds, 4 * one.sparse.seconds, 0.2 * four.sparse.seconds);
  EXPECT_NEAR(four.dense.flops, 64 * one.dense.flops, 1);
  EXPECT_NEAR(four.iterative.bytes, 4 * one.iterative.bytes, 0.05 * four.iterative.bytes);
}

TEST(LinearSolverCost, ChoosesByShape) {
  EXPECT_EQ(Choose(SparseStructure({9}, {{0}})), LinearSolverType::kDenseSchur);
  EXPECT_EQ(Choose(Band(16, 16)), LinearSolverType::kDenseSchur);
  EXPECT_EQ(Choose(Band(100, 100)), FullSystemSolver());
  EXPECT_EQ(Choose(Band(400, 20)), LinearSolverType::kSparseSchur);
  EXPECT_EQ(Choose(Scattered(3000, 20)), LinearSolverType::kIterativeSchur);
}

TEST(LinearSolverCost, LeavesOutAFullSystemOfFewObservations) {
  const BlockStructure full = Band(500, 500);
  const FillOrdering ordering = FindFillOrdering(full);
  const auto costs = [&](int64_t num_observations) {
    return PredictLinearSolverCosts(full, ordering, 2, num_observations);
  };
  EXPECT_TRUE(LeavesOutSystem(costs(60'000), kPlenty));
  EXPECT_FALSE(LeavesOutSystem(costs(6'000'000), kPlenty));
  EXPECT_FALSE(LeavesOutSystem(costs(0), kPlenty));
  EXPECT_TRUE(LeavesOutSystem(costs(6'000'000), costs(0).iterative.bytes));
  EXPECT_FALSE(LeavesOutSystem(costs(0), costs(0).iterative.bytes));
  EXPECT_EQ(ChooseLinearSolver(full, ordering, 2, kPlenty, 60'000).type,
            LinearSolverType::kIterativeSchur);
  EXPECT_EQ(ChooseLinearSolver(full, ordering, 2, kPlenty).type, FullSystemSolver());
  const BlockStructure band = Band(500, 20);
  EXPECT_FALSE(
      LeavesOutSystem(PredictLinearSolverCosts(band, FindFillOrdering(band), 2, 60'000), kPlenty));
}

TEST(LinearSolverCost, LeavesOutASystemThatTakesLongToForm) {
  const BlockStructure full = Band(320, 320);
  const FillOrdering ordering = FindFillOrdering(full);
  const auto choose = [&](int64_t num_pairs) {
    return ChooseLinearSolver(full, ordering, 2, kPlenty, 150'000, num_pairs).type;
  };
  EXPECT_EQ(choose(0), FullSystemSolver());
  EXPECT_EQ(choose(20'000'000), LinearSolverType::kIterativeSchur);
  const auto leaves_out = [&](int64_t num_pairs) {
    return LeavesOutSystem(PredictLinearSolverCosts(full, ordering, 2, 600'000, num_pairs),
                           kPlenty);
  };
  EXPECT_FALSE(leaves_out(0));
  EXPECT_TRUE(leaves_out(100'000'000));
  // Other solvers form S as well: the time does not count between them.
  EXPECT_EQ(ChooseLinearSolver(full, ordering, 2, kPlenty, 0, 20'000'000).type, FullSystemSolver());
}

TEST(LinearSolverCost, ChoosesWhatFitsIntoMemory) {
  const BlockStructure full = Band(100, 100);
  const LinearSolverCosts costs = Predict(full, 2);
  EXPECT_LT(costs.iterative.bytes, costs.dense.bytes);
  EXPECT_EQ(Choose(full, costs.iterative.bytes), LinearSolverType::kIterativeSchur);
  const std::string reason =
      ChooseLinearSolver(full, FindFillOrdering(full), 2, costs.iterative.bytes).reason;
  EXPECT_NE(reason.find("dense needs"), std::string::npos) << reason;
}

TEST(LinearSolverCost, TellsTimesWithoutExponents) {
  const BlockStructure band = Band(60, 20);
  const FillOrdering ordering = FindFillOrdering(band);
  for (int64_t num_pairs = 1; num_pairs < 1'000'000'000'000; num_pairs *= 3) {
    const std::string reason = ChooseLinearSolver(band, ordering, 2, kPlenty, 0, num_pairs).reason;
    EXPECT_FALSE(std::regex_search(reason, std::regex("[0-9]e[+-]"))) << reason;
  }
  const std::string reason =
      ChooseLinearSolver(SparseStructure({1}, {{0}}), FillOrdering(), 2, kPlenty).reason;
  EXPECT_FALSE(std::regex_search(reason, std::regex("[0-9]e[+-]"))) << reason;
}

}  // namespace
}  // namespace bundle
