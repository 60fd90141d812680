#include "core/solve/coupled_blocks.h"

#include <algorithm>
#include <cstdint>

#include "core/problem/tracks.h"

namespace bundle {

std::vector<std::vector<int>> FindDirectlyCoupledBlocks(const ProblemView& problem,
                                                        const ParameterLayout& layout) {
  const auto num_blocks = static_cast<int>(layout.blocks().size());
  std::vector<std::vector<int>> columns(num_blocks);
  for (int j = 0; j < num_blocks; ++j) columns[j].push_back(j);
  for (int i = 0; i < problem.num_images; ++i) {
    const int pose = layout.image_block(i), camera = layout.camera_block(problem.image_camera[i]);
    if (pose >= 0 && camera >= 0) columns[std::min(pose, camera)].push_back(std::max(pose, camera));
  }
  return columns;
}

std::vector<std::vector<int>> FindCoupledBlocks(const ProblemView& problem,
                                                const ParameterLayout& layout) {
  const auto num_blocks = static_cast<int>(layout.blocks().size());
  const Tracks tracks = GroupByPoint(problem);
  std::vector<std::vector<int>> points_of(num_blocks);
  const auto visit_blocks = [&](int image, const auto& visit) {
    const int pose = layout.image_block(image);
    const int camera = layout.camera_block(problem.image_camera[image]);
    if (pose >= 0) visit(pose);
    if (camera >= 0) visit(camera);
  };
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i], point = problem.observation_point[i];
    if (!layout.point_is_free(point)) continue;
    visit_blocks(image, [&](int block) {
      if (points_of[block].empty() || points_of[block].back() != point) {
        points_of[block].push_back(point);
      }
    });
  }
  std::vector<std::vector<int>> columns = FindDirectlyCoupledBlocks(problem, layout);
  std::vector<int> seen(num_blocks, -1);
  for (int j = 0; j < num_blocks; ++j) {
    for (const int block : columns[j]) seen[block] = j;
    for (const int point : points_of[j]) {
      for (int64_t k = tracks.starts[point]; k < tracks.starts[point + 1]; ++k) {
        visit_blocks(tracks.images[k], [&](int block) {
          if (block < j || seen[block] == j) return;
          seen[block] = j;
          columns[j].push_back(block);
        });
      }
    }
    std::sort(columns[j].begin(), columns[j].end());
  }
  return columns;
}

}  // namespace bundle
