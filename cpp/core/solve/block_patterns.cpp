#include "core/solve/block_patterns.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/problem/tracks.h"
#include "core/solve/coupled_blocks.h"

namespace bundle {
namespace {

constexpr int kPointSize = 3;

std::vector<int> BlockSizes(const ParameterLayout& layout) {
  std::vector<int> sizes;
  sizes.reserve(layout.blocks().size());
  for (const CameraSideBlock& block : layout.blocks()) sizes.push_back(block.size);
  return sizes;
}

void AddPoints(const ProblemView& problem, const ParameterLayout& layout, BlockPattern* pattern) {
  const Tracks tracks = GroupByPoint(problem);
  const int first_block = layout.num_free_points();
  std::vector<int> rows;
  for (int point = 0; point < problem.num_points; ++point) {
    if (!layout.point_is_free(point)) continue;
    rows.assign(1, static_cast<int>(pattern->size.size()));
    for (int64_t k = tracks.starts[point]; k < tracks.starts[point + 1]; ++k) {
      const int image = tracks.images[k];
      const int pose = layout.image_block(image);
      const int camera = layout.camera_block(problem.image_camera[image]);
      if (pose >= 0) rows.push_back(first_block + pose);
      if (camera >= 0) rows.push_back(first_block + camera);
    }
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    pattern->row.insert(pattern->row.end(), rows.begin(), rows.end());
    pattern->size.push_back(kPointSize);
    pattern->column_begin.push_back(static_cast<int64_t>(pattern->row.size()));
  }
}

}  // namespace

BlockPattern ReducedPattern(const ProblemView& problem, const ParameterLayout& layout) {
  return MakeBlockPattern(BlockSizes(layout), FindCoupledBlocks(problem, layout));
}

BlockPattern FullPattern(const ProblemView& problem, const ParameterLayout& layout) {
  BlockPattern pattern;
  AddPoints(problem, layout, &pattern);
  const int first_block = layout.num_free_points();
  for (std::vector<int>& rows : FindDirectlyCoupledBlocks(problem, layout)) {
    for (const int row : rows) pattern.row.push_back(first_block + row);
    pattern.column_begin.push_back(static_cast<int64_t>(pattern.row.size()));
  }
  const std::vector<int> sizes = BlockSizes(layout);
  pattern.size.insert(pattern.size.end(), sizes.begin(), sizes.end());
  return pattern;
}

}  // namespace bundle
