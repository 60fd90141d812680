/// The factor of the exact Hessian against differences of the gradient.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <vector>

#include "core/covariance/adjoint.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::Scene;

/// Two constant images, which hold the world, and constant points.
SolveOptions Held() {
  SolveOptions options;
  options.fixed_image_ids = {1, 5};
  options.fixed_point_ids = {1001, 1007};
  options.num_threads = 2;
  return options;
}

Scene OfTwoCameras(double perturbation) {
  testing::SceneOptions options;
  options.num_images = 4;
  options.num_points = 12;
  options.images_per_camera = 2;
  options.perturbation = perturbation;
  return MakeScene(options);
}

std::unique_ptr<AdjointSystem> MakeSystem(const AdjustmentProblem& problem,
                                          const SolveOptions& options, bool exact = true) {
  return AdjointSystem::Make(problem, nullptr, options, exact);
}

/// Column j of H, by a central difference of fourth order.
Eigen::VectorXd Column(AdjointSystem* system, Eigen::Index j, double h) {
  const auto at = [&](double e) {
    Eigen::VectorXd step = Eigen::VectorXd::Zero(system->size()), gradient(system->size());
    step[j] = e;
    system->Gradient(step.data(), gradient.data());
    return gradient;
  };
  return (8 * (at(h / 2) - at(-h / 2)) - (at(h) - at(-h))) / (6 * h);
}

Eigen::MatrixXd Hessian(AdjointSystem* system) {
  const Eigen::Index n = system->size();
  Eigen::MatrixXd hessian(n, n);
  for (Eigen::Index j = 0; j < n; ++j) {
    const double own = Column(system, j, 1e-6)[j];
    hessian.col(j) = Column(system, j, own > 0 ? 1e-2 / std::sqrt(own) : 1e-6);
  }
  return hessian;
}

Eigen::VectorXd Solved(AdjointSystem* system, const Eigen::VectorXd& y) {
  Eigen::VectorXd a(system->size());
  system->Solve(y.data(), a.data());
  return a;
}

class AdjointFactor : public ::testing::TestWithParam<LossType> {};

TEST_P(AdjointFactor, SolvesWithTheExactHessian) {
  const Scene scene = OfTwoCameras(1e-4);
  const AdjustmentProblem problem = scene.View();
  SolveOptions options = Held();
  options.loss = GetParam();
  options.loss_scale = 2;
  const std::unique_ptr<AdjointSystem> system = MakeSystem(problem, options);
  const std::unique_ptr<AdjointSystem> plain = MakeSystem(problem, options, false);
  ASSERT_TRUE(system->is_exact());
  ASSERT_FALSE(plain->is_exact());
  ASSERT_EQ(system->degrees(), 0);
  Eigen::MatrixXd hessian = Hessian(system.get());
  Eigen::VectorXd y = Eigen::VectorXd::LinSpaced(hessian.rows(), 1, 2).array().cos();
  for (Eigen::Index j = 0; j < y.size(); ++j) {
    if (!hessian.row(j).isZero(0)) continue;  // a constant point
    hessian.col(j).setZero();
    hessian(j, j) = 1;
    y[j] = 0;
  }
  ASSERT_LT((hessian - hessian.transpose()).norm(), 1e-6 * hessian.norm());
  const Eigen::VectorXd expected = hessian.llt().solve(y);
  const auto error = [&](AdjointSystem* of) {
    const Eigen::VectorXd off = Solved(of, y) - expected;
    return std::sqrt(off.dot(hessian * off) / expected.dot(hessian * expected));
  };
  EXPECT_LT(error(system.get()), 1e-7);
  EXPECT_GT(error(plain.get()), 1e-3);
}

INSTANTIATE_TEST_SUITE_P(Losses, AdjointFactor,
                         ::testing::Values(LossType::kTrivial, LossType::kSoftL1,
                                           LossType::kCauchy));

TEST(AdjointFactor, IsThatOfGaussNewtonWithoutCurvature) {
  const Scene scene = OfTwoCameras(1e-2);
  const AdjustmentProblem problem = scene.View();
  SolveOptions options = Held();
  options.loss = LossType::kCauchy;
  options.loss_scale = 0.1;
  const std::unique_ptr<AdjointSystem> system = MakeSystem(problem, options);
  const std::unique_ptr<AdjointSystem> plain = MakeSystem(problem, options, false);
  EXPECT_FALSE(system->is_exact());
  const Eigen::VectorXd y = Eigen::VectorXd::Ones(system->size());
  const Eigen::VectorXd expected = Solved(plain.get(), y);
  EXPECT_LT((Solved(system.get(), y) - expected).norm(), 1e-9 * expected.norm());
}

TEST(AdjointFactor, LeavesPointsWithoutObservationsOut) {
  const Scene scene = OfTwoCameras(1e-4);
  Scene more = scene;
  more.points.insert(more.points.end(), {0.1, 0.2, 0.3});
  more.point_ids.push_back(9999);
  const AdjustmentProblem fewer = scene.View(), problem = more.View();
  const std::unique_ptr<AdjointSystem> before = MakeSystem(fewer, Held());
  const std::unique_ptr<AdjointSystem> system = MakeSystem(problem, Held());
  ASSERT_TRUE(system->is_exact());
  Eigen::VectorXd y = Eigen::VectorXd::Ones(system->size());
  const Eigen::VectorXd a = Solved(system.get(), y);
  const Eigen::VectorXd expected = Solved(before.get(), y.head(before->size()));
  EXPECT_TRUE(a.tail(3).isZero(0));
  EXPECT_LT((a.head(expected.size()) - expected).norm(), 1e-12 * expected.norm());
}

}  // namespace
}  // namespace bundle
