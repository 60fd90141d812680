#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <random>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/linear/clusters.h"
#include "core/linear/preconditioners.h"
#include "linear/random_system.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kNumGaugeDirections = BlockSystem::kNumGaugeDirections;

/// Random directions, of which the last three columns of a block of more than six, and all of a
/// block of at most three, know nothing: intrinsics.
MatrixXd GiveSimilarities(const RandomSystem& from, unsigned seed, BlockSystem* system) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  MatrixXd all = MatrixXd::Zero(from.num_columns(), kNumGaugeDirections);
  int row = 0;
  for (const int size : from.sizes) {
    const int moved = size <= 3 ? 0 : std::min(size, 6);
    for (int k = 0; k < size; ++k, ++row) {
      if (k >= moved) continue;
      for (int m = 0; m < kNumGaugeDirections; ++m) all(row, m) = normal(random);
    }
  }
  for (int i = 0; i < row; ++i) {
    for (int m = 0; m < kNumGaugeDirections; ++m) system->gauge_directions.push_back(all(i, m));
  }
  return all;
}

/// M^-1 as a matrix, column by column.
MatrixXd Inverse(Preconditioner* preconditioner, int n) {
  MatrixXd inverse(n, n);
  for (int k = 0; k < n; ++k) {
    const VectorXd unit = VectorXd::Unit(n, k);
    preconditioner->Multiply(unit.data(), inverse.col(k).data());
  }
  return inverse;
}

MatrixXd BlockDiagonalInverseOf(const RandomSystem& system) {
  MatrixXd inverse = MatrixXd::Zero(system.num_columns(), system.num_columns());
  int first = 0;
  for (const int size : system.sizes) {
    inverse.block(first, first, size, size) =
        oracle::Inverse(system.s.block(first, first, size, size));
    first += size;
  }
  return inverse;
}

struct Case {
  RandomSystem system;
  MatrixXd gauge_directions;
  MatrixXd inverse;  ///< M^-1
};

Case MakeCase(int num_blocks, int size, unsigned seed, int num_threads, double coupling = 0.3) {
  Case made{MakeRandomSystem(std::vector<int>(num_blocks, size), coupling, seed), {}, {}};
  const BlockStructure structure = SparseStructure(made.system.sizes, made.system.columns);
  BlockSystem stored = Store(made.system, structure);
  made.gauge_directions = GiveSimilarities(made.system, seed, &stored);
  const auto preconditioner = MakeTwoLevelPreconditioner(structure, num_threads);
  EXPECT_TRUE(preconditioner->NeedsGaugeDirections());
  EXPECT_TRUE(preconditioner->Update(stored, made.system.scale));
  made.inverse = Inverse(preconditioner.get(), made.system.num_columns());
  return made;
}

class TwoLevelSizes : public testing::TestWithParam<int> {};

INSTANTIATE_TEST_SUITE_P(Reduced, TwoLevelSizes, testing::Values(3, 5, 6, 8, 9, 13, 22));

TEST_P(TwoLevelSizes, IsSymmetricAndAboveSchurJacobi) {
  const Case c = MakeCase(17, GetParam(), 1, 2);
  const double norm = c.inverse.norm();
  EXPECT_LE((c.inverse - c.inverse.transpose()).norm(), 1e-12 * norm);
  const MatrixXd correction = c.inverse - BlockDiagonalInverseOf(c.system);
  const SymmetricEigen eigen = DecomposeSymmetric((correction + correction.transpose()) / 2);
  EXPECT_GE(eigen.values.minCoeff(), -1e-12 * norm);
}

// Q A^-1 Q^T S q = q for all q in the span of Q, whatever its basis is.
TEST_P(TwoLevelSizes, CorrectsSimilaritiesAndSharedIntrinsicsExactly) {
  const Case c = MakeCase(17, GetParam(), 2, 2);
  const MatrixXd correction = c.inverse - BlockDiagonalInverseOf(c.system);
  const auto expect_fixed = [&](const VectorXd& q) {
    const VectorXd found = correction * (c.system.s * q);
    EXPECT_LE((found - q).norm(), 1e-8 * q.norm());
  };
  for (int m = 0; m < kNumGaugeDirections; ++m) expect_fixed(c.gauge_directions.col(m));
  const int size = GetParam(), moved = size <= 3 ? 0 : std::min(size, 6);
  for (int k = moved; k < size; ++k) {
    VectorXd q = VectorXd::Zero(c.system.num_columns());
    for (int row = k; row < q.size(); row += size) q[row] = 1;
    expect_fixed(q);
  }
}

// One cluster: the correction is that on the span of its directions, computed densely.
TEST(TwoLevel, IsTheProjectionForASingleCluster) {
  const Case c = MakeCase(6, 6, 3, 1, 1.1);
  const MatrixXd& q = c.gauge_directions;
  const MatrixXd expected = BlockDiagonalInverseOf(c.system) +
                            q * oracle::Inverse(q.transpose() * c.system.s * q) * q.transpose();
  EXPECT_LE((c.inverse - expected).norm(), 1e-9 * expected.norm());
}

TEST(TwoLevel, HasTheSameBitsForAnyNumberOfThreads) {
  const Case one = MakeCase(60, 9, 4, 1);
  for (const int threads : {2, 3}) EXPECT_EQ(one.inverse, MakeCase(60, 9, 4, threads).inverse);
}

TEST(TwoLevel, LeavesSchurJacobiWhereTheCoarseSystemIsNotPositiveDefinite) {
  RandomSystem system = MakeRandomSystem({6, 6}, 1.1, 5);
  const MatrixXd expected = BlockDiagonalInverseOf(system);
  system.s.block(6, 0, 6, 6) = 100 * MatrixXd::Identity(6, 6);
  system.s.block(0, 6, 6, 6) = 100 * MatrixXd::Identity(6, 6);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  BlockSystem stored = Store(system, structure);
  GiveSimilarities(system, 5, &stored);
  const auto preconditioner = MakeTwoLevelPreconditioner(structure, 1);
  ASSERT_TRUE(preconditioner->Update(stored, system.scale));
  EXPECT_LE((Inverse(preconditioner.get(), 12) - expected).norm(), 1e-12 * expected.norm());
}

TEST(TwoLevel, FailsWhereADiagonalBlockDoes) {
  RandomSystem system = MakeRandomSystem({6, 6}, 1.1, 5);
  system.s(7, 7) = -1;
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  BlockSystem stored = Store(system, structure);
  GiveSimilarities(system, 5, &stored);
  EXPECT_FALSE(MakeTwoLevelPreconditioner(structure, 1)->Update(stored, system.scale));
}

TEST(Clusters, PutEveryBlockIntoOneOfAtMostTheSizeAsked) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(50, 1), 0.2, 1);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  std::vector<char> alone(50, 0);
  alone[7] = alone[20] = 1;
  const std::vector<int> cluster =
      ClusterBlocks(structure, Store(system, structure).values, alone, 6);
  ASSERT_EQ(cluster.size(), 50u);
  const int count = 1 + *std::max_element(cluster.begin(), cluster.end());
  for (int c = 0; c < count; ++c) {
    const auto size = std::count(cluster.begin(), cluster.end(), c);
    EXPECT_GE(size, 1);
    EXPECT_LE(size, 6);
  }
  EXPECT_EQ(std::count(cluster.begin(), cluster.end(), cluster[7]), 1);
  EXPECT_EQ(std::count(cluster.begin(), cluster.end(), cluster[20]), 1);
}

TEST(Clusters, KeepWhatIsCoupledMostTogether) {
  // Blocks 0 2 4 and 1 3 5, strongly; the two groups, weakly.
  RandomSystem system = MakeRandomSystem(std::vector<int>(6, 2), 1.1, 2);
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      const double coupling = i == j ? 1 : (i - j) % 2 == 0 ? 0.3 : 0.01;
      system.s.block(2 * i, 2 * j, 2, 2) = coupling * MatrixXd::Identity(2, 2);
    }
  }
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const BlockValues values = Store(system, structure).values;
  const std::vector<char> none(6, 0);
  EXPECT_EQ(ClusterBlocks(structure, values, none, 3), (std::vector<int>{0, 1, 0, 1, 0, 1}));
}

TEST(Clusters, OfNothingAreNone) {
  EXPECT_TRUE(ClusterBlocks(SparseStructure({}, {}), {}, {}, 6).empty());
}

}  // namespace
}  // namespace bundle
