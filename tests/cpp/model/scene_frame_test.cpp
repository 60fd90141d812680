#include "core/model/scene_frame.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::Scene;

/// Cameras and points moved by `distance` along x, the cameras without rotation.
Scene Shifted(double distance) {
  Scene scene = MakeScene({});
  for (int i = 0; i < scene.num_images(); ++i) {
    double* const pose = &scene.cam_from_world[7 * static_cast<size_t>(i)];
    for (int j = 0; j < 4; ++j) pose[j] = j == 3 ? 1 : 0;
    pose[4] -= distance;
  }
  for (size_t k = 0; k < scene.points.size(); k += 3) scene.points[k] += distance;
  return scene;
}

/// Across the shift, subtracting the origin and adding it again rounds: what the solve did not
/// touch is copied.
TEST(CenteredProblem, MovesBackWhatChangedAndCopiesTheRest) {
  const Scene scene = Shifted(1e5);
  const AdjustmentProblem view = scene.View();
  const SceneFrame frame(view);
  ASSERT_TRUE(frame.IsFarFromOrigin());
  const CenteredProblem centered(view, frame);
  ASSERT_TRUE(centered.is_moved());
  SolveOutput output;
  output.cam_from_world.assign(centered.view().cam_from_world,
                               centered.view().cam_from_world + scene.cam_from_world.size());
  output.points.assign(centered.view().points, centered.view().points + scene.points.size());
  output.cam_from_world[4] += 0.25;
  output.points[5] += 0.25;
  centered.MoveBack(&output);
  for (size_t k = 7; k < output.cam_from_world.size(); ++k) {
    EXPECT_EQ(output.cam_from_world[k], scene.cam_from_world[k]) << k;
  }
  for (size_t k = 0; k < output.points.size(); ++k) {
    if (k / 3 == 1) continue;
    EXPECT_EQ(output.points[k], scene.points[k]) << k;
  }
  EXPECT_NEAR(output.cam_from_world[4], scene.cam_from_world[4] + 0.25, 1e-9);
  EXPECT_NEAR(output.points[5], scene.points[5] + 0.25, 1e-9);
  EXPECT_NEAR(output.points[3], scene.points[3], 1e-9);
}

/// A distance that no double holds moves nothing, however small the scene is.
TEST(SceneFrame, AnInfiniteDistanceIsNotFar) {
  constexpr double kFar = 1.5e308;
  Scene scene = MakeScene({});
  for (size_t k = 0; k < scene.cam_from_world.size(); ++k) {
    scene.cam_from_world[k] = k % 7 < 3 ? 0 : k % 7 == 3 ? 1 : -kFar;
  }
  for (double& x : scene.points) x = kFar + 1e300 * x;
  const SceneFrame frame(scene.View());
  EXPECT_TRUE(std::isfinite(frame.size));
  EXPECT_GT(frame.size, 0);
  EXPECT_FALSE(frame.IsFarFromOrigin());
}

/// The norm of all that is free, cameras and near points, with and without the far points.
TEST(FindFarPoints, LeaveTheNormByWhatTheyAddToIt) {
  Scene scene = MakeScene({});
  const double size = SceneFrame(scene.View()).size;
  const size_t far[] = {3, 11};
  for (const size_t p : far) {
    for (int j = 0; j < 3; ++j) scene.points[3 * p + j] = j == 0 ? 2000 * size : 0;
  }
  // Of the order of the far ones, so that it counts who is in which sum.
  for (size_t k = 15; k < 30; ++k) scene.points[k] = 450 * size;
  const AdjustmentProblem view = scene.View();
  const SceneFrame frame(view);
  const auto expected = [&](const ParameterLayout& layout) {
    double all = 0, near = 0;
    for (const double x : layout.InitialState(view)) all += x * x, near += x * x;
    for (int p = 0; p < view.num_points; ++p) {
      if (!layout.point_is_free(p)) continue;
      const double* const point = view.points + 3 * static_cast<size_t>(p);
      const double square = point[0] * point[0] + point[1] * point[1] + point[2] * point[2];
      all += square;
      if (static_cast<size_t>(p) != far[0] && static_cast<size_t>(p) != far[1]) near += square;
    }
    return std::sqrt(near / all);
  };
  SolveOptions options;
  const ParameterLayout all_free(view, SelectFreeParameters(view, options));
  const double both = FindFarPoints(view, all_free, frame).norm_without;
  EXPECT_NEAR(both, expected(all_free), 1e-12);
  EXPECT_GT(both, 0.3);
  EXPECT_LT(both, 0.9);
  options.fixed_point_ids = {scene.point_ids[far[0]]};
  const ParameterLayout one_free(view, SelectFreeParameters(view, options));
  const double one = FindFarPoints(view, one_free, frame).norm_without;
  EXPECT_NEAR(one, expected(one_free), 1e-12);
  EXPECT_GT(one, both + 0.01);
  options.fixed_point_ids.push_back(scene.point_ids[far[1]]);
  const ParameterLayout none_free(view, SelectFreeParameters(view, options));
  EXPECT_EQ(FindFarPoints(view, none_free, frame).norm_without, 1);
  EXPECT_NE(FindFarPoints(view, none_free, frame).warning.find("2 (2 held)"), std::string::npos);
}

/// Cameras alone, no near points: their parameters are in the norm.
TEST(FindFarPoints, TheNormHasTheCameras) {
  Scene scene = MakeScene({});
  scene.points[0] = 2000;
  SolveOptions options;
  for (int p = 1; p < scene.num_points(); ++p) {
    options.fixed_point_ids.push_back(scene.point_ids[p]);
  }
  const AdjustmentProblem view = scene.View();
  const ParameterLayout layout(view, SelectFreeParameters(view, options));
  const SceneFrame frame(view);
  ASSERT_GT(frame.DistanceTo(view.points), kFarPoint * frame.size * 0.3);
  double cameras = 0, point = 0;
  for (const double x : layout.InitialState(view)) cameras += x * x;
  scene.points[0] = 2 * kFarPoint * frame.size;
  for (int j = 0; j < 3; ++j) point += scene.points[j] * scene.points[j];
  const SceneFrame with_far(view);
  EXPECT_NEAR(FindFarPoints(view, layout, with_far).norm_without,
              std::sqrt(cameras / (cameras + point)), 1e-12);
}

}  // namespace
}  // namespace bundle
