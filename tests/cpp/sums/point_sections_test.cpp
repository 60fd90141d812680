#include "core/sums/point_sections.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <tuple>
#include <vector>

#include "support/scene.h"

namespace bundle {
namespace {

testing::Scene MakeScene() {
  testing::SceneOptions options;
  options.num_images = 30;
  options.num_points = 4000;
  options.track_length = 5;
  testing::Scene scene = testing::MakeScene(options);
  testing::ShuffleObservations(3, &scene);
  return scene;
}

/// By the definition: points in order, and the observations of those before.
std::vector<uint16_t> Expected(const ProblemView& problem) {
  struct Point {
    int first = 1 << 30, last = -1, index = 0, seen = 0;
  };
  std::vector<Point> points(problem.num_points);
  for (int p = 0; p < problem.num_points; ++p) points[p].index = p;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    Point& point = points[problem.observation_point[i]];
    point.first = std::min(point.first, problem.observation_image[i]);
    point.last = std::max(point.last, problem.observation_image[i]);
    ++point.seen;
  }
  std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) {
    return std::tie(a.first, a.last, a.index) < std::tie(b.first, b.last, b.index);
  });
  const int sections = NumPointSections(problem.num_observations);
  std::vector<uint16_t> expected(problem.num_points);
  int64_t before = 0;
  for (const Point& point : points) {
    expected[point.index] = static_cast<uint16_t>(
        std::min<int64_t>(before * sections / problem.num_observations, sections - 1));
    before += point.seen;
  }
  return expected;
}

TEST(PointSections, AreCutInTheOrderOfImages) {
  const testing::Scene scene = MakeScene();
  const ProblemView problem = scene.View();
  const std::vector<uint16_t> one = testing::SectionsOf(problem, 1);
  EXPECT_EQ(one, Expected(problem));
  EXPECT_EQ(one, testing::SectionsOf(problem, 4));
  EXPECT_EQ(*std::max_element(one.begin(), one.end()), 11);
}

TEST(PointSections, OfPointsThatNoImageSees) {
  const testing::Scene scene = MakeScene();
  ProblemView problem = scene.View();
  problem.num_observations = 7;
  EXPECT_EQ(testing::SectionsOf(problem, 2), Expected(problem));
  problem.num_observations = 0;
  const std::vector<uint16_t> none = testing::SectionsOf(problem, 2);
  EXPECT_EQ(std::count(none.begin(), none.end(), 0), problem.num_points);
  problem.num_points = 0;
  EXPECT_TRUE(testing::SectionsOf(problem, 2).empty());
}

TEST(PointSections, GrowWithTheProblem) {
  for (const int64_t observations : {int64_t{0}, int64_t{1} << 20, int64_t{1} << 40}) {
    EXPECT_EQ(NumPointSections(observations) % 12, 0);
  }
  EXPECT_EQ(NumPointSections(83718), 12);
  EXPECT_LT(NumPointSections(int64_t{1} << 50), 1 << 16);
}

}  // namespace
}  // namespace bundle
