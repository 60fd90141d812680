#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <functional>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/conjugate_gradients.h"
#include "core/linear/linear_solver.h"
#include "core/linear/symmetric_product.h"
#include "core/parallel/thread_pool.h"
#include "linear/random_system.h"

namespace bundle {
namespace {

using Status = LinearStatus;
using Eigen::MatrixXd;
using Eigen::VectorXd;

struct Reference {
  VectorXd x;
  int num_iterations = 0;
};

/// Conjugate gradients as in the textbook on the scaled system C S C y = C b, stopped as Ceres
/// stops them; every residual is computed from its definition.
Reference SolveScaled(const RandomSystem& system,
                      const std::function<VectorXd(VectorXd)>& precondition, double eta) {
  const Eigen::Map<const VectorXd> scale(system.scale.data(), system.num_columns());
  const MatrixXd s = scale.asDiagonal() * system.s * scale.asDiagonal();
  const VectorXd b = scale.asDiagonal() * system.b;
  VectorXd y = VectorXd::Zero(b.size());
  VectorXd r = b, p;
  double rho = 0, model = 0;
  for (int i = 1;; ++i) {
    const VectorXd z = precondition(r);
    const double last_rho = rho;
    rho = r.dot(z);
    p = i == 1 ? z : VectorXd(z + rho / last_rho * p);
    y += rho / p.dot(s * p) * p;
    r = b - s * y;
    const double last_model = model;
    model = y.dot(s * y) - 2 * b.dot(y);
    if (i * (model - last_model) / model < eta || i == std::min(500, system.num_columns())) {
      return {scale.asDiagonal() * y, i};
    }
  }
}

/// M^-1 of the scaled system by its definition, densely.
std::function<VectorXd(VectorXd)> DensePreconditioner(const RandomSystem& system,
                                                      PreconditionerType type) {
  const int n = system.num_columns();
  const Eigen::Map<const VectorXd> scale(system.scale.data(), n);
  const MatrixXd s = scale.asDiagonal() * system.s * scale.asDiagonal();
  const MatrixXd u = scale.asDiagonal() * system.u * scale.asDiagonal();
  MatrixXd inverse = MatrixXd::Identity(n, n);
  if (type == PreconditionerType::kJacobi) inverse = oracle::Inverse(u);
  if (type == PreconditionerType::kSchurJacobi) {
    MatrixXd diagonal = MatrixXd::Zero(n, n);
    int first = 0;
    for (const int size : system.sizes) {
      diagonal.block(first, first, size, size) = s.block(first, first, size, size);
      first += size;
    }
    inverse = oracle::Inverse(diagonal);
  }
  if (type == PreconditionerType::kSchurPowerSeriesExpansion) {
    const MatrixXd u_inverse = oracle::Inverse(u);
    const MatrixXd step = u_inverse * (u - s);
    MatrixXd term = u_inverse;
    inverse = term;
    for (int i = 0; i < 5; ++i) {
      term = step * term;
      inverse += term;
    }
  }
  return [inverse](const VectorXd& r) { return VectorXd(inverse * r); };
}

class Preconditioners : public testing::TestWithParam<PreconditionerType> {};

INSTANTIATE_TEST_SUITE_P(Reduced, Preconditioners,
                         testing::Values(PreconditionerType::kIdentity, PreconditionerType::kJacobi,
                                         PreconditionerType::kSchurJacobi,
                                         PreconditionerType::kSchurPowerSeriesExpansion),
                         [](const auto& test) {
                           for (const auto& [name, type] : kPreconditionerTypes) {
                             if (type == test.param) return std::string(name);
                           }
                           return std::string("unknown");
                         });

TEST_P(Preconditioners, IterateAsOnTheScaledSystem) {
  for (unsigned seed = 0; seed < 12; ++seed) {
    const int num_blocks = 1 + static_cast<int>(seed);
    const RandomSystem system = MakeRandomSystem(RandomSizes(num_blocks, seed), 0.3, seed);
    const BlockStructure structure = SparseStructure(system.sizes, system.columns);
    const auto solver = MakeIterativeSolver(structure, GetParam(), 2);
    for (const double eta : {0.1, 1e-2, 1e-3}) {
      BlockSystem stored = Store(system, structure);
      VectorXd x(system.num_columns());
      const LinearSolution solution = solver->Solve(&stored, system.scale, eta, x.data());
      const Reference expected = SolveScaled(system, DensePreconditioner(system, GetParam()), eta);
      ASSERT_EQ(solution.status, Status::kSuccess) << solution.message;
      EXPECT_EQ(solution.num_iterations, expected.num_iterations) << seed << " " << eta;
      EXPECT_LE((x - expected.x).norm(), 1e-8 * expected.x.norm()) << seed << " " << eta;
    }
  }
}

TEST_P(Preconditioners, ReachTheSolution) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(40, 5), 0.1, 5);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, GetParam(), 2);
  BlockSystem stored = Store(system, structure);
  VectorXd x(system.num_columns());
  const LinearSolution solution = solver->Solve(&stored, system.scale, 1e-15, x.data());
  ASSERT_EQ(solution.status, Status::kSuccess) << solution.message;
  const VectorXd exact = ExactSolution(system);
  EXPECT_LE((x - exact).norm(), 1e-6 * exact.norm());
}

TEST_P(Preconditioners, FailOnNan) {
  RandomSystem system = MakeRandomSystem(RandomSizes(4, 1), 0.5, 1);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  system.s(2, 2) = system.u(2, 2) = std::numeric_limits<double>::quiet_NaN();
  const auto solver = MakeIterativeSolver(structure, GetParam(), 2);
  BlockSystem stored = Store(system, structure);
  VectorXd x(system.num_columns());
  EXPECT_EQ(solver->Solve(&stored, system.scale, 0.1, x.data()).status, Status::kFailure);
}

TEST_P(Preconditioners, ReadTheCameraDiagonalIfTheySaySo) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(4, 1), 0.5, 1);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, GetParam(), 2);
  BlockSystem stored = Store(system, structure);
  if (!solver->NeedsCameraDiagonal()) stored.camera_diagonal.clear();
  VectorXd x(system.num_columns());
  EXPECT_EQ(solver->Solve(&stored, system.scale, 0.1, x.data()).status, Status::kSuccess);
}

TEST(IterativeSolver, RefusesABlockThatIsNotPositiveDefinite) {
  RandomSystem system = MakeRandomSystem({6, 6}, 1, 1);
  system.s(3, 3) = -1;
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kSchurJacobi, 1);
  BlockSystem stored = Store(system, structure);
  VectorXd x(12);
  EXPECT_EQ(solver->Solve(&stored, system.scale, 0.1, x.data()).status, Status::kFailure);
}

TEST(IterativeSolver, KeepsWhatItHasOfAnIndefiniteSystem) {
  RandomSystem system = MakeRandomSystem({6, 6}, 1, 1);
  system.s = -system.s;
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kIdentity, 1);
  BlockSystem stored = Store(system, structure);
  VectorXd x(12);
  const LinearSolution solution = solver->Solve(&stored, system.scale, 0.1, x.data());
  EXPECT_EQ(solution.status, Status::kSuccess);
  EXPECT_EQ(solution.num_iterations, 1);
  EXPECT_TRUE(x.isZero());
}

TEST(IterativeSolver, NeedsNoIterationWithoutARightSide) {
  RandomSystem system = MakeRandomSystem({6, 6}, 1, 1);
  system.b.setZero();
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kSchurJacobi, 1);
  BlockSystem stored = Store(system, structure);
  VectorXd x = VectorXd::Ones(12);
  EXPECT_EQ(solver->Solve(&stored, system.scale, 0.1, x.data()).num_iterations, 0);
  EXPECT_TRUE(x.isZero());
}

/// The solver's operations with the identity as preconditioner, one by one, so that not a
/// bit may differ; the residual is computed from x in every `period`-th iteration.
std::vector<double> IterateInTheSameOrder(const RandomSystem& system,
                                          const BlockStructure& structure, int num_iterations,
                                          int period) {
  using Vector = std::vector<double>;
  const auto dot = [](const Vector& a, const Vector& b) {
    return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
  };
  const BlockSystem stored = Store(system, structure);
  SymmetricProduct product(structure, 1);
  const size_t n = stored.rhs.size();
  Vector x(n), r = stored.rhs, z(n), p(n), q(n);
  double last_rho = 1;
  for (int i = 1; i <= num_iterations; ++i) {
    for (size_t k = 0; k < n; ++k) z[k] = system.scale[k] * system.scale[k] * r[k];
    const double rho = dot(r, z);
    for (size_t k = 0; k < n; ++k) p[k] = z[k] + (i == 1 ? 0 : rho / last_rho * p[k]);
    last_rho = rho;
    product.Multiply(stored.values, p.data(), q.data());
    const double alpha = rho / dot(p, q);
    for (size_t k = 0; k < n; ++k) x[k] += alpha * p[k];
    if (i % period == 0) product.Multiply(stored.values, x.data(), z.data());
    for (size_t k = 0; k < n; ++k) {
      r[k] = i % period == 0 ? stored.rhs[k] - z[k] : r[k] - alpha * q[k];
    }
  }
  return x;
}

TEST(IterativeSolver, ComputesTheResidualAfreshEveryTenthTime) {
  const RandomSystem system = MakeRandomSystem(RandomSizes(40, 5), 0.3, 5);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kIdentity, 1);
  BlockSystem stored = Store(system, structure);
  std::vector<double> x(system.num_columns());
  const int num_iterations = solver->Solve(&stored, system.scale, 1e-12, x.data()).num_iterations;
  ASSERT_GT(num_iterations, 20);
  EXPECT_EQ(x, IterateInTheSameOrder(system, structure, num_iterations, 10));
  EXPECT_NE(x, IterateInTheSameOrder(system, structure, num_iterations, 9));
  EXPECT_NE(x, IterateInTheSameOrder(system, structure, num_iterations, 1000));
}

TEST(IterativeSolver, IsLeftBetweenIterations) {
  const RandomSystem system = MakeRandomSystem({6, 6}, 1, 1);
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kIdentity, 1);
  BlockSystem stored = Store(system, structure);
  std::vector<double> x(12);
  const InterruptionScope scope([] { return true; });
  EXPECT_THROW(solver->Solve(&stored, system.scale, 0.1, x.data()), Interrupted);
}

TEST(IterativeSolver, StopsAtAResidualOfZero) {
  RandomSystem system = MakeRandomSystem({2, 2}, 1, 1);
  system.s = Eigen::Vector4d(4, 16, 1, 64).asDiagonal();
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const auto solver = MakeIterativeSolver(structure, PreconditionerType::kSchurJacobi, 1);
  BlockSystem stored = Store(system, structure);
  VectorXd x(4);
  const LinearSolution solution = solver->Solve(&stored, system.scale, 0.1, x.data());
  EXPECT_EQ(solution.status, Status::kSuccess) << solution.message;
  EXPECT_EQ(solution.num_iterations, 2);
  EXPECT_EQ(x, ExactSolution(system));
}

TEST(IterativeSolver, SolvesASystemWithoutBlocks) {
  const BlockStructure structure = SparseStructure({}, {});
  BlockSystem empty;
  for (const auto& [name, type] : kPreconditionerTypes) {
    const auto solver = MakeIterativeSolver(structure, type, 2);
    EXPECT_EQ(solver->Solve(&empty, {}, 0.1, nullptr).status, Status::kSuccess) << name;
  }
}

/// Many ranges of columns and block sizes; half the block pairs. No solver could solve it.
RandomSystem MakeLargeSystem() {
  RandomSystem system;
  system.sizes = RandomSizes(120, 9);
  const int n = std::accumulate(system.sizes.begin(), system.sizes.end(), 0);
  system.s = MatrixXd::Zero(n, n);
  system.u = MatrixXd::Zero(n, n);
  system.b = VectorXd::Random(n);
  system.columns.resize(system.sizes.size());
  int column = 0;
  for (size_t j = 0; j < system.sizes.size(); ++j) {
    int row = column;
    for (size_t i = j; i < system.sizes.size(); ++i) {
      if (i == j || (i * j) % 2 == 0) {
        system.columns[j].push_back(static_cast<int>(i));
        system.s.block(row, column, system.sizes[i], system.sizes[j]).setRandom();
      }
      row += system.sizes[i];
    }
    column += system.sizes[j];
  }
  system.s = MatrixXd(system.s.selfadjointView<Eigen::Lower>());
  return system;
}

TEST(SymmetricProduct, AgreesWithTheWholeMatrix) {
  const RandomSystem system = MakeLargeSystem();
  for (const bool dense : {false, true}) {
    const BlockStructure structure =
        dense ? DenseStructure(system.sizes) : SparseStructure(system.sizes, system.columns);
    SymmetricProduct product(structure, 2);
    const VectorXd x = VectorXd::Random(system.num_columns());
    VectorXd y(system.num_columns());
    product.Multiply(Store(system, structure).values, x.data(), y.data());
    const VectorXd expected = system.s * x;
    EXPECT_LE((y - expected).norm(), 1e-13 * expected.norm());
  }
}

TEST(SymmetricProduct, IsTheSameForAnyNumberOfThreads) {
  const RandomSystem system = MakeLargeSystem();
  const BlockStructure structure = SparseStructure(system.sizes, system.columns);
  const BlockValues values = Store(system, structure).values;
  VectorXd one(system.num_columns()), many(system.num_columns());
  SymmetricProduct(structure, 1).Multiply(values, system.b.data(), one.data());
  for (const int num_threads : {2, 3, 5}) {
    SymmetricProduct(structure, num_threads).Multiply(values, system.b.data(), many.data());
    EXPECT_EQ(one, many);
  }
}

}  // namespace
}  // namespace bundle
