#include "core/model/problem_factors.h"

#include <bundle/richardson.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "core/model/scene_frame.h"
#include "support/some_factors.h"

namespace bundle {
namespace {

using testing::FactorMaker;
using testing::Kind;
using testing::Scene;
using testing::SmallScene;

std::vector<double> Evaluate(const ChartedFactor& factor, const CameraStates& cameras,
                             const std::vector<double>& points, std::vector<double>* jacobian) {
  std::vector<const double*> at;
  for (const int p : factor.unknowns().points) at.push_back(&points[3 * static_cast<size_t>(p)]);
  std::vector<double> residual(factor.num_residuals());
  EXPECT_TRUE(factor.Evaluate(cameras, at.data(), residual.data(),
                              jacobian == nullptr ? nullptr : jacobian->data()));
  return residual;
}

/// The Jacobian against differences of the residual by every unknown.
void CheckJacobian(const ChartedFactor& factor, const AdjustmentProblem& problem,
                   const ParameterLayout& layout, std::vector<double> state,
                   std::vector<double> points, double tolerance) {
  CameraStates cameras(problem, layout);
  cameras.Update(state.data());
  const int rows = factor.num_residuals();
  std::vector<double> jacobian(static_cast<size_t>(rows) * factor.num_columns());
  Evaluate(factor, cameras, points, &jacobian);
  std::vector<double*> unknowns;
  for (const int p : factor.unknowns().points) {
    for (int k = 0; k < 3; ++k) unknowns.push_back(&points[3 * static_cast<size_t>(p) + k]);
  }
  for (const int b : factor.unknowns().blocks) {
    const CameraBlock& block = layout.blocks()[b];
    for (int k = 0; k < block.size; ++k) unknowns.push_back(&state[block.offset + k]);
  }
  ASSERT_EQ(static_cast<int>(unknowns.size()), factor.num_columns());
  // Focal lengths of some hundred pixels are rounded by 1e-13.
  std::vector<double> noise(rows, 1e-12), derivative(rows), uncertainty(rows);
  for (size_t j = 0; j < unknowns.size(); ++j) {
    const double start = *unknowns[j];
    const auto along = [&](double step, double* values) {
      *unknowns[j] = start + step;
      cameras.Update(state.data());
      const std::vector<double> residual = Evaluate(factor, cameras, points, nullptr);
      std::copy(residual.begin(), residual.end(), values);
      return true;
    };
    RichardsonDerivative(along, rows, 1e-2, noise.data(), derivative.data(), uncertainty.data());
    *unknowns[j] = start;
    for (int r = 0; r < rows; ++r) {
      const double found = jacobian[r * unknowns.size() + j];
      EXPECT_NEAR(found, derivative[r], tolerance * (1 + std::abs(derivative[r])))
          << factor.factor().name() << ", row " << r << ", column " << j;
    }
  }
}

/// A state some way along the chart, where J_l(w) is far from the identity.
std::vector<double> FarState(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  std::vector<double> state = layout.InitialState(problem);
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const CameraBlock& block : layout.blocks()) {
    for (int k = 0; k < block.size && block.columns[k] < kPoseSize; ++k) {
      state[block.offset + k] += 0.4 * normal(random);
    }
  }
  return state;
}

TEST(ChartedFactor, JacobiansAreThoseOfTheUnknowns) {
  for (const int images_per_camera : {1, 2}) {
    const Scene scene = SmallScene(images_per_camera);
    FactorMaker maker(scene);
    maker.AddAll(LossType::kTrivial, scene.num_cameras());
    const ProblemFactors factors = maker.Take();
    AdjustmentProblem problem = scene.View();
    problem.factors = &factors;
    for (const bool moved : {false, true}) {
      for (int j = 0; j < 3; ++j) problem.origin[j] = moved ? 2.0 * j - 3 : 0;
      SolveOptions options;
      options.refine_principal_point = moved;
      options.fixed_image_ids = {scene.image_ids[3]};
      const ParameterLayout layout(problem, SelectFreeParameters(problem, options));
      for (const auto& factor : factors.factors) {
        CheckJacobian(ChartedFactor(*factor, problem, layout), problem, layout,
                      FarState(problem, layout), scene.points, 1e-8);
      }
    }
  }
}

TEST(ChartedFactor, SeesTheWorldOfTheUser) {
  Scene scene = SmallScene(1);
  for (size_t k = 0; k < scene.points.size(); ++k) scene.points[k] += k % 3 == 0 ? 5e6 : 1e6;
  for (size_t i = 0; i < scene.cam_from_world.size(); i += 7) {
    double rotation[9], moved[3];
    QuaternionToRotation(&scene.cam_from_world[i], rotation);
    const double shift[3] = {5e6, 1e6, 1e6};
    MatrixVector3(rotation, shift, moved);
    for (int j = 0; j < 3; ++j) scene.cam_from_world[i + 4 + j] -= moved[j];
  }
  FactorMaker maker(scene);
  maker.AddAll(LossType::kTrivial, scene.num_cameras());
  const ProblemFactors factors = maker.Take();
  AdjustmentProblem problem = scene.View();
  problem.factors = &factors;
  const SceneFrame frame(problem);
  const CenteredProblem centered(problem, frame);
  ASSERT_TRUE(centered.is_moved());
  const ParameterLayout here(problem, SelectFreeParameters(problem, {}));
  const ParameterLayout there(centered.view(), SelectFreeParameters(centered.view(), {}));
  const CameraStates cameras(problem, here), centered_cameras(centered.view(), there);
  const std::vector<double> centered_points(centered.view().points,
                                            centered.view().points + scene.points.size());
  for (const auto& factor : factors.factors) {
    const auto expected =
        Evaluate(ChartedFactor(*factor, problem, here), cameras, scene.points, nullptr);
    const auto found = Evaluate(ChartedFactor(*factor, centered.view(), there), centered_cameras,
                                centered_points, nullptr);
    for (size_t r = 0; r < found.size(); ++r) {
      EXPECT_NEAR(found[r], expected[r], 1e-6 * (1 + std::abs(expected[r]))) << factor->name();
    }
  }
}

TEST(ChartedFactor, WhatIsHeldHasNoColumn) {
  const Scene scene = SmallScene(2);
  FactorMaker maker(scene);
  maker.Prior(Kind::kImage, 1, LossType::kTrivial);
  maker.Prior(Kind::kCamera, 0, LossType::kTrivial);
  maker.Prior(Kind::kPoint, 2, LossType::kTrivial);
  const ProblemFactors factors = maker.Take();
  AdjustmentProblem problem = scene.View();
  problem.factors = &factors;
  SolveOptions options;
  options.fixed_image_ids = {scene.image_ids[1]};
  options.refine_focal = options.refine_extra = false;
  const ParameterLayout layout(problem, SelectFreeParameters(problem, options));
  const auto unknowns = FindFactorUnknowns(problem, layout);
  EXPECT_TRUE(unknowns[0].blocks.empty());
  EXPECT_TRUE(unknowns[1].blocks.empty());
  EXPECT_EQ(unknowns[2].points, std::vector<int>{2});
  EXPECT_TRUE(ChartedFactor(*factors.factors[0], problem, layout).is_fixed());
}

TEST(ProblemFactors, LossesAreThoseOfCeres) {
  // Their values and Ceres' are compared by the solves of both backends; here that rho', rho'' are
  // the derivatives of rho.
  for (const auto& [name, loss] : kLossTypes) {
    for (const double s : {0.3, 3.0, 5.0, 40.0}) {
      double rho[3], above[3], below[3];
      const double h = 1e-5 * s;
      ValueOfLoss(loss, 2, s, rho);
      ValueOfLoss(loss, 2, s + h, above);
      ValueOfLoss(loss, 2, s - h, below);
      EXPECT_NEAR(rho[1], (above[0] - below[0]) / (2 * h), 1e-8) << name << s;
      EXPECT_NEAR(rho[2], (above[1] - below[1]) / (2 * h), 1e-8) << name << s;
    }
  }
}

}  // namespace
}  // namespace bundle
