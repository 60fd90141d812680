#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "core/problem/reprojection_errors.h"
#include "support/scene.h"

namespace bundle {
namespace {

/// Whatever memory held before, and whether or not an observation counts.
TEST(Linearize, DerivativesBeyondTheModelsParametersAreZero) {
  testing::SceneOptions options;
  options.num_images = 2;
  options.num_points = 3;
  testing::Scene scene = testing::MakeScene(options);
  scene.points[2] = -100;  // behind the cameras
  const auto n = static_cast<size_t>(scene.num_observations());
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> residual(2 * n, kNaN), d_pose(12 * n, kNaN), d_point(6 * n, kNaN);
  std::vector<double> d_params(2 * n * testing::Scene::kStride, kNaN);
  const std::vector<double> offsets(3 * size_t{2});
  Linearize(scene.View(), offsets.data(), Cheirality::kZero,
            {residual.data(), d_pose.data(), d_params.data(), d_point.data()});
  const int num_params = scene.camera_models[0]->num_params;
  ASSERT_LT(num_params, testing::Scene::kStride);
  for (size_t row = 0; row < 2 * n; ++row) {
    const bool counts = scene.observation_point[row / 2] != 0;
    const double* const of_row = &d_params[row * testing::Scene::kStride];
    EXPECT_EQ(of_row[0] != 0, counts) << row;  // by the focal length
    for (int k = num_params; k < testing::Scene::kStride; ++k) EXPECT_EQ(of_row[k], 0) << row;
  }
}

}  // namespace
}  // namespace bundle
