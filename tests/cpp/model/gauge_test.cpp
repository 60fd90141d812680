#include "core/model/gauge.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "support/scene.h"

namespace bundle {
namespace {

/// Twelve points around the origin at distance 1, the origin, and two pairs further out.
testing::Scene Ring(double near, double far) {
  constexpr double kPi = 3.14159265358979323846;
  testing::SceneOptions options;
  options.num_points = 17;
  testing::Scene scene = testing::MakeScene(options);
  std::vector<double> points;
  for (int i = 0; i < 12; ++i) {
    points.insert(points.end(), {std::cos(i * kPi / 6), std::sin(i * kPi / 6), 0});
  }
  points.insert(points.end(), {0, 0, 0, near, 0, 0, -near, 0, 0, 0, far, 0, 0, -far, 0});
  scene.points = points;
  return scene;
}

/// Coordinates of the points that the gauge fixes.
std::vector<std::vector<double>> FixedPoints(const testing::Scene& scene) {
  FreeParameters free;
  free.pose.assign(scene.num_images(), 0x3f);
  free.point.assign(scene.num_points(), 1);
  EXPECT_TRUE(FixGauge(scene.View(), Gauge::kThreePoints, &free).empty());
  std::vector<std::vector<double>> fixed;
  for (int p = 0; p < scene.num_points(); ++p) {
    if (free.point[p] != 0) continue;
    fixed.emplace_back(scene.points.begin() + 3 * p, scene.points.begin() + 3 * p + 3);
  }
  return fixed;
}

// The bulk ends at twice the median distance, 1 here: what is within is taken as far apart as
// possible, what is beyond is not taken.
TEST(Gauge, ThreePointsAreFarApartWithinTheBulk) {
  const auto fixed = FixedPoints(Ring(1.98, 2.02));
  ASSERT_EQ(fixed.size(), 3u);
  EXPECT_EQ(fixed[0], (std::vector<double>{1, 0, 0}));
  EXPECT_NEAR(std::abs(fixed[1][1]), 1, 1e-12);  // not 2.02
  EXPECT_EQ(fixed[2], (std::vector<double>{-1.98, 0, 0}));
}

TEST(Gauge, ThreePointsReachTheEndOfTheBulk) {
  const auto fixed = FixedPoints(Ring(1.98, 1.99));
  ASSERT_EQ(fixed.size(), 3u);
  EXPECT_EQ(std::abs(fixed[1][1]) + std::abs(fixed[2][1]), 1.99);
}

}  // namespace
}  // namespace bundle
