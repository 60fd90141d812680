#include "core/model/gauge_count.h"

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/model/gauge.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

Scene MakeRigScene(int num_sensors, double baseline, bool last_alone = false) {
  SceneOptions options;
  options.num_images = 6;
  options.num_points = 12;
  Scene scene = MakeScene(options);
  if (num_sensors > 0) testing::MakeRigs(num_sensors, baseline, last_alone, &scene);
  return scene;
}

/// Leaves the observations of some images only.
void Observe(const std::function<bool(int)>& keeps, Scene* scene) {
  size_t kept = 0;
  for (size_t i = 0; i < scene->observation_image.size(); ++i) {
    if (!keeps(scene->observation_image[i])) continue;
    scene->observation_image[kept] = scene->observation_image[i];
    scene->observation_point[kept] = scene->observation_point[i];
    for (int j = 0; j < 2; ++j) {
      scene->observation_xy[2 * kept + j] = scene->observation_xy[2 * i + j];
    }
    ++kept;
  }
  scene->observation_image.resize(kept);
  scene->observation_point.resize(kept);
  scene->observation_xy.resize(2 * kept);
}

int NumFree(const FreeParameters& free) {
  int count = 0;
  for (const auto* bits : {&free.pose, &free.frame, &free.sensor}) {
    for (const uint8_t b : *bits) count += __builtin_popcount(b);
  }
  return count;
}

/// Counts the gauge, and what two_cameras takes away: exactly that, with nothing left.
int Degrees(const Scene& scene, const SolveOptions& options = {}) {
  const AdjustmentProblem problem = scene.View();
  FreeParameters free = SelectFreeParameters(problem, options);
  const int degrees = CountGaugeDegrees(problem, free);
  const int before = NumFree(free);
  EXPECT_EQ(FixGauge(problem, Gauge::kTwoCameras, &free), "");
  EXPECT_EQ(before - NumFree(free), degrees);
  EXPECT_EQ(CountGaugeDegrees(problem, free), 0);
  return degrees;
}

TEST(GaugeCount, WithoutRigs) {
  const Scene scene = MakeRigScene(0, 0);
  EXPECT_EQ(Degrees(scene), 7);
  const std::vector<int64_t>&images = scene.image_ids, &points = scene.point_ids;
  const auto held = [&](size_t num_images, size_t num_points) {
    SolveOptions options;
    options.fixed_image_ids.assign(images.begin(), images.begin() + num_images);
    options.fixed_point_ids.assign(points.begin(), points.begin() + num_points);
    return Degrees(scene, options);
  };
  EXPECT_EQ(held(1, 0), 1);
  EXPECT_EQ(held(2, 0), 0);
  EXPECT_EQ(held(0, 1), 4);
  EXPECT_EQ(held(0, 2), 1);
  EXPECT_EQ(held(0, 3), 0);
  EXPECT_EQ(held(1, 1), 0);
}

TEST(GaugeCount, AFixedBaselineGivesTheScale) {
  for (const int num_sensors : {2, 3}) {
    for (const bool last_alone : {false, true}) {
      EXPECT_EQ(Degrees(MakeRigScene(num_sensors, 0.3, last_alone)), 6);
      EXPECT_EQ(Degrees(MakeRigScene(num_sensors, 1e-7, last_alone)), 6);
      EXPECT_EQ(Degrees(MakeRigScene(num_sensors, 0, last_alone)), 7);
    }
  }
}

TEST(GaugeCount, RefinedSensorsLeaveTheScale) {
  SolveOptions options;
  options.refine_sensor_from_rig = true;
  const Scene scene = MakeRigScene(3, 0.3);
  EXPECT_EQ(Degrees(scene, options), 7);
  EXPECT_EQ(Degrees(MakeRigScene(3, 0), options), 7);
  options.fixed_sensors = {{7, scene.camera_ids[2]}};
  EXPECT_EQ(Degrees(scene, options), 6);
  options.fixed_sensors.clear();
  options.fixed_image_ids = {scene.image_ids[3]};  // its frame
  EXPECT_EQ(Degrees(scene, options), 1);
  options.fixed_image_ids = {scene.image_ids[4]};
  EXPECT_THROW(SelectFreeParameters(scene.View(), options), InputError);
  options.refine_sensor_from_rig = false;
  EXPECT_EQ(Degrees(scene, options), 0);
}

/// Only what is seen counts: two sensors in one frame.
TEST(GaugeCount, WhatIsSeen) {
  Scene references = MakeRigScene(2, 0.3);
  Observe([](int image) { return image % 2 == 0; }, &references);
  EXPECT_EQ(Degrees(references), 7);
  Scene alternating = MakeRigScene(2, 0.3);
  Observe([](int image) { return image == 0 || image == 3 || image == 4; }, &alternating);
  EXPECT_EQ(Degrees(alternating), 7);
  Scene without_reference = MakeRigScene(3, 0.3);
  Observe([](int image) { return image % 3 != 0; }, &without_reference);
  SolveOptions options;
  options.refine_sensor_from_rig = true;
  EXPECT_EQ(SelectFreeParameters(without_reference.View(), options).sensor,
            (std::vector<uint8_t>{0, 0}));
  EXPECT_EQ(Degrees(without_reference, options), 6);
}

/// With one frame, a coordinate of a sensor holds the scale.
TEST(GaugeCount, OneFrame) {
  Scene scene = MakeRigScene(3, 0.3);
  Observe([](int image) { return image < 3; }, &scene);
  EXPECT_EQ(Degrees(scene), 6);
  SolveOptions options;
  options.refine_sensor_from_rig = true;
  EXPECT_EQ(Degrees(scene, options), 7);
}

TEST(GaugeCount, ThreePointsAreNotTakenFromRigs) {
  const Scene scene = MakeRigScene(2, 0.3);
  FreeParameters free = SelectFreeParameters(scene.View(), {});
  EXPECT_NE(FixGauge(scene.View(), Gauge::kThreePoints, &free), "");
  EXPECT_EQ(free.point, std::vector<uint8_t>(scene.point_ids.size(), 1));
  EXPECT_EQ(CountGaugeDegrees(scene.View(), free), 0);
}

}  // namespace
}  // namespace bundle
