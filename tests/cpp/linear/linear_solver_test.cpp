/// The contract of every linear solver: Factorize once, Solve any number of times.

#include "core/linear/linear_solver.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/conjugate_gradients.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"
#include "linear/random_system.h"

namespace bundle::linear_solver_test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using Status = LinearStatus;

constexpr double kEta = 1e-15;  // as far as conjugate gradients come

struct Made {
  BlockStructure structure;
  std::unique_ptr<LinearSolver> solver;
};

/// "dense", "sparse" or a preconditioner.
Made Make(const std::string& name, const RandomSystem& system) {
  Made made;
  if (name == "dense") {
    made.structure = DenseStructure(system.sizes);
    made.solver = MakeDenseSolver(made.structure, 2);
    return made;
  }
  made.structure = SparseStructure(system.sizes, system.columns);
  if (name == "sparse") {
    FillOrdering ordering;
    ordering.name = "natural";
    ordering.order.resize(system.sizes.size());
    std::iota(ordering.order.begin(), ordering.order.end(), 0);
    made.solver = MakeSparseSolver(ordering, 2, &made.structure);
    return made;
  }
  for (const auto& [known, type] : kPreconditionerTypes) {
    if (known == name) made.solver = MakeIterativeSolver(made.structure, type, 2);
  }
  return made;
}

BlockSystem Stored(const RandomSystem& system, const BlockStructure& structure) {
  BlockSystem stored = Store(system, structure);
  stored.gauge_directions.resize(static_cast<size_t>(system.num_columns()) *
                                 BlockSystem::kNumGaugeDirections);
  for (size_t i = 0; i < stored.gauge_directions.size(); ++i) {
    stored.gauge_directions[i] = static_cast<double>(i * 7919 % 101) / 50 - 1;
  }
  return stored;
}

MatrixXd Exact(const RandomSystem& system, const MatrixXd& rhs) {
  return oracle::SolveSymmetric(system.s.cast<oracle::Real>(), rhs.cast<oracle::Real>())
      .cast<double>();
}

void ExpectSolution(LinearSolver* solver, const MatrixXd& rhs, const MatrixXd& exact,
                    double tolerance) {
  const int num_rhs = static_cast<int>(rhs.cols());
  MatrixXd x = MatrixXd::Constant(rhs.rows(), num_rhs, 1e300);
  const LinearSolution solution = solver->Solve(rhs.data(), num_rhs, kEta, x.data());
  ASSERT_EQ(solution.status, Status::kSuccess) << solution.message;
  for (int k = 0; k < num_rhs; ++k) {
    EXPECT_LE((x.col(k) - exact.col(k)).norm(), tolerance * exact.col(k).norm()) << k;
  }
}

class LinearSolvers : public testing::TestWithParam<const char*> {
 protected:
  bool IsDirect() const {
    return GetParam() == std::string("dense") || GetParam() == std::string("sparse");
  }
  double Tolerance() const { return IsDirect() ? 1e-11 : 1e-6; }
};

INSTANTIATE_TEST_SUITE_P(All, LinearSolvers,
                         testing::Values("dense", "sparse", "identity", "jacobi", "schur_jacobi",
                                         "schur_power_series_expansion", "two_level"),
                         [](const auto& test) { return std::string(test.param); });

TEST_P(LinearSolvers, TakeAnyNumberOfRightHandSides) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    const RandomSystem system = MakeRandomSystem(RandomSizes(25, seed), 0.15, seed);
    Made made = Make(GetParam(), system);
    BlockSystem stored = Stored(system, made.structure);
    ASSERT_EQ(made.solver->Factorize(&stored, system.scale).status, Status::kSuccess);
    std::srand(seed);
    const MatrixXd rhs = MatrixXd::Random(system.num_columns(), 7), exact = Exact(system, rhs);
    for (const int num_rhs : {1, 2, 7, 2}) {  // and twice after one factorisation
      SCOPED_TRACE(num_rhs);
      ExpectSolution(made.solver.get(), rhs.leftCols(num_rhs), exact.leftCols(num_rhs),
                     Tolerance());
    }
    EXPECT_EQ(made.solver->Solve(nullptr, 0, kEta, nullptr).status, Status::kSuccess);
  }
}

TEST_P(LinearSolvers, SolveAStepInTwoCallsAsInOne) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(12, 4), 0.3, 4);
  Made made = Make(GetParam(), system);
  BlockSystem stored = Stored(system, made.structure);
  VectorXd x(system.num_columns()), again(system.num_columns());
  const LinearSolution one = made.solver->Solve(&stored, system.scale, 0.1, x.data());
  stored = Stored(system, made.structure);
  ASSERT_EQ(made.solver->Factorize(&stored, system.scale).status, Status::kSuccess);
  const LinearSolution two = made.solver->Solve(stored.rhs.data(), 1, 0.1, again.data());
  EXPECT_EQ(x, again);
  EXPECT_EQ(one.num_iterations, two.num_iterations);
  EXPECT_EQ(one.message, two.message);
}

TEST_P(LinearSolvers, RefuseToSolveBeforeTheyFactorise) {
  const RandomSystem system = MakeRandomSystem({3, 4}, 1, 2);
  const Made made = Make(GetParam(), system);
  VectorXd x(7);
  EXPECT_THROW(made.solver->Solve(system.b.data(), 1, kEta, x.data()), std::logic_error);
}

TEST_P(LinearSolvers, FactoriseAgainAfterAFailure) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(9, 3), 0.4, 3);
  Made made = Make(GetParam(), system);
  const MatrixXd rhs = system.b;
  VectorXd x(system.num_columns());
  for (int repeat = 0; repeat < 2; ++repeat) {
    RandomSystem bad = system;
    bad.s(5, 5) = bad.u(5, 5) = -1e3;
    BlockSystem spoilt = Stored(bad, made.structure);
    const LinearSolution failed = made.solver->Factorize(&spoilt, system.scale);
    if (GetParam() != std::string("identity")) {  // which never looks at S
      EXPECT_EQ(failed.status, Status::kFailure);
      EXPECT_FALSE(failed.message.empty());
      EXPECT_THROW(made.solver->Solve(rhs.data(), 1, kEta, x.data()), std::logic_error);
    }
    BlockSystem stored = Stored(system, made.structure);
    ASSERT_EQ(made.solver->Factorize(&stored, system.scale).status, Status::kSuccess);
    ExpectSolution(made.solver.get(), rhs, Exact(system, rhs), Tolerance());
  }
}

/// Clusters are formed from the first system's values, and after ForgetValues from the next.
TEST_P(LinearSolvers, SolveAsNewOnesAfterForgettingValues) {
  const RandomSystem other = MakeRandomSystem(std::vector<int>(30, 6), 0.2, 5);
  RandomSystem system = other;
  // The same structure with other strengths.
  system.s.diagonal() *= 1.5;
  for (int k = 0; k < 90; ++k) {
    system.s.row(k) *= 0.3, system.s.col(k) *= 0.3;
    system.u.row(k) *= 0.3, system.u.col(k) *= 0.3;
  }
  for (int k = 0; k < system.num_columns(); ++k) {
    for (int l = 0; l < k; ++l) {
      if (k / 6 == l / 6) continue;
      const double factor = ((k / 6 * 31 + l / 6 * 17) % 5) / 5.0;
      system.s(k, l) *= factor;
      system.s(l, k) *= factor;
    }
  }
  const auto solve = [&](LinearSolver* solver, const BlockStructure& structure,
                         const RandomSystem& from) {
    BlockSystem stored = Stored(from, structure);
    VectorXd x(from.num_columns());
    const LinearSolution solution = solver->Solve(&stored, from.scale, 0.1, x.data());
    EXPECT_EQ(solution.status, Status::kSuccess) << solution.message;
    return x;
  };
  const Made fresh = Make(GetParam(), system), used = Make(GetParam(), system);
  const VectorXd expected = solve(fresh.solver.get(), fresh.structure, system);
  solve(used.solver.get(), used.structure, other);
  if (GetParam() == std::string("two_level")) {
    EXPECT_NE(solve(used.solver.get(), used.structure, system), expected);
  }
  used.solver->ForgetValues();
  EXPECT_EQ(solve(used.solver.get(), used.structure, system), expected);
}

}  // namespace
}  // namespace bundle::linear_solver_test
