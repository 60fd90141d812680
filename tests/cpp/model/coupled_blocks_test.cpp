#include "core/model/coupled_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "core/prepare/prepare.h"
#include "support/scene.h"

namespace bundle {
namespace {

/// With so many points that the threads share them, and cameras that images share.
TEST(CoupledBlocks, AreThoseThatMeetInAFreePointOrAResidual) {
  testing::SceneOptions options;
  options.num_images = 150;
  options.num_points = 42000;
  options.track_length = 2;
  options.images_per_camera = 2;
  testing::Scene scene = testing::MakeScene(options);
  SolveOptions solve_options;
  for (size_t p = 0; p < scene.point_ids.size(); ++p) {
    if (p % 20 != 0) solve_options.fixed_point_ids.push_back(scene.point_ids[p]);
  }
  testing::ShuffleObservations(3, &scene);
  const AdjustmentProblem problem = scene.View();
  const ParameterLayout layout = PrepareSolve(problem, solve_options).layout;

  std::vector<std::set<int>> blocks_of_point(problem.num_points);
  std::set<std::vector<int>> expected;
  const auto add_pairs = [&](const std::set<int>& blocks) {
    for (const int a : blocks) {
      for (const int b : blocks) {
        if (a >= b) expected.insert({b, a});
      }
    }
  };
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i], point = problem.observation_point[i];
    const std::set<int> blocks = {layout.image_block(image),
                                  layout.camera_block(problem.image_camera[image])};
    add_pairs(blocks);
    if (layout.point_is_free(point)) blocks_of_point[point].insert(blocks.begin(), blocks.end());
  }
  for (const std::set<int>& blocks : blocks_of_point) add_pairs(blocks);

  for (const int num_threads : {1, 4}) {
    std::vector<std::vector<int>> found;
    const std::vector<std::vector<int>> columns = FindCoupledBlocks(problem, layout, num_threads);
    for (size_t j = 0; j < columns.size(); ++j) {
      for (const int i : columns[j]) found.push_back({static_cast<int>(j), i});
    }
    EXPECT_EQ(found, std::vector<std::vector<int>>(expected.begin(), expected.end()));
  }
  const auto n = layout.blocks().size();
  EXPECT_LT(expected.size(), n * (n + 1) / 2);
}

}  // namespace
}  // namespace bundle
