#include "core/solve/block_patterns.h"

#include <algorithm>
#include <cstdint>
#include <new>
#include <numeric>
#include <utility>
#include <vector>

#include "core/problem/tracks.h"
#include "core/solve/coupled_blocks.h"
#include "core/symbolic/orderings.h"

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

std::vector<int> OrderByAmd(const BlockPatternView& pattern) {
  std::vector<int> order = FindOrder(pattern, OrderingMethod::kAmd);
  if (static_cast<int>(order.size()) != pattern.num_blocks) throw std::bad_alloc();
  return order;
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

int64_t NumInformationNonzeros(const ProblemView& problem, const ParameterLayout& layout) {
  const std::vector<int> sizes = BlockSizes(layout);
  const BlockPattern cameras = MakeBlockPattern(sizes, FindDirectlyCoupledBlocks(problem, layout));
  const int64_t num_points = layout.num_free_points();
  int64_t count = static_cast<int64_t>(NumNonzeros(cameras)) + kPointSize * kPointSize * num_points;

  const Tracks tracks = GroupByPoint(problem);
  std::vector<int> last_point(sizes.size(), -1);  // that a block was counted for
  for (int point = 0; point < problem.num_points; ++point) {
    if (!layout.point_is_free(point)) continue;
    for (int64_t k = tracks.starts[point]; k < tracks.starts[point + 1]; ++k) {
      const int image = tracks.images[k];
      for (const int block :
           {layout.image_block(image), layout.camera_block(problem.image_camera[image])}) {
        if (block < 0 || last_point[block] == point) continue;
        last_point[block] = point;
        count += 2 * kPointSize * sizes[block];
      }
    }
  }
  return count;
}

OrderedPattern OrderFullPattern(const ProblemView& problem, const ParameterLayout& layout,
                                int64_t most_entries) {
  OrderedPattern result;
  result.pattern = FullPattern(problem, layout);
  const BlockPatternView view = result.pattern;
  if (view.num_entries() <= most_entries) {
    result.order = OrderByAmd(view);
    return result;
  }
  const int num_points = layout.num_free_points();
  result.points_first = true;
  result.order.resize(num_points);
  std::iota(result.order.begin(), result.order.end(), 0);
  for (const int block : OrderReducedPattern(problem, layout).order) {
    result.order.push_back(num_points + block);
  }
  return result;
}

OrderedPattern OrderReducedPattern(const ProblemView& problem, const ParameterLayout& layout) {
  OrderedPattern result;
  result.pattern = ReducedPattern(problem, layout);
  result.order = OrderByAmd(result.pattern);
  return result;
}

}  // namespace bundle
