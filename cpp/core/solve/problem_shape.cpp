#include "core/solve/problem_shape.h"

#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

namespace bundle {
namespace {

/// Beyond this many blocks the bit matrix of pairs (n^2 / 8 bytes) is not worth its memory.
constexpr int kMaxBlocksToCount = 20000;

/// Observations grouped by point: those of point p are order[starts[p]] to order[starts[p + 1] -
/// 1].
struct Tracks {
  std::vector<int64_t> starts;
  std::vector<int32_t> images;
};

Tracks GroupByPoint(const ProblemView& problem) {
  Tracks tracks;
  tracks.starts.resize(static_cast<size_t>(problem.num_points) + 1);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    ++tracks.starts[problem.observation_point[i] + 1];
  }
  for (int p = 0; p < problem.num_points; ++p) tracks.starts[p + 1] += tracks.starts[p];
  tracks.images.resize(problem.num_observations);
  std::vector<int64_t> next(tracks.starts.begin(), tracks.starts.end() - 1);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    tracks.images[next[problem.observation_point[i]]++] = problem.observation_image[i];
  }
  return tracks;
}

}  // namespace

// Two blocks meet in S where one residual has both, or where a free point is seen by both.
double CountSchurDensity(const ProblemView& problem, const ParameterLayout& layout) {
  const auto n = static_cast<int64_t>(layout.blocks().size());
  if (n == 0 || n > kMaxBlocksToCount) return -1;
  std::vector<bool> meets(static_cast<size_t>(n * n));
  const Tracks tracks = GroupByPoint(problem);
  std::vector<int> seen;
  const auto mark_all_pairs = [&] {
    for (const int a : seen) {
      for (const int b : seen) meets[a * n + b] = true;
    }
  };
  for (int p = 0; p < problem.num_points; ++p) {
    seen.clear();
    for (int64_t i = tracks.starts[p]; i < tracks.starts[p + 1]; ++i) {
      const int image = tracks.images[i];
      if (!layout.point_is_free(p)) seen.clear();
      for (const int block :
           {layout.image_block(image), layout.camera_block(problem.image_camera[image])}) {
        if (block >= 0) seen.push_back(block);
      }
      if (!layout.point_is_free(p)) mark_all_pairs();
    }
    std::sort(seen.begin(), seen.end());
    seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
    mark_all_pairs();
  }
  const auto count = static_cast<double>(std::count(meets.begin(), meets.end(), true));
  return count / (static_cast<double>(n) * static_cast<double>(n));
}

ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals) {
  ProblemShape shape;
  shape.num_residuals = num_residuals;
  shape.num_free_points = layout.num_free_points();
  shape.num_camera_columns = layout.state_size();
  shape.num_camera_blocks = static_cast<int>(layout.blocks().size());
  return shape;
}

}  // namespace bundle
