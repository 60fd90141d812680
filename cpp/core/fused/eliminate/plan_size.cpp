#include "core/fused/eliminate/plan_size.h"

#include <algorithm>

#include "core/fused/eliminate/model_groups.h"
#include "core/fused/eliminate/point_plan.h"

namespace bundle::fused {

PlanSize MeasurePlan(const ProblemView& problem, const ParameterLayout& layout) {
  const int block_doubles = GroupImages(problem, layout).block_size();
  const PointPlan plan =
      PlanPoints(problem, layout, block_doubles * static_cast<int>(sizeof(double)));
  PlanSize size;
  size.num_points = plan.num_points();
  size.num_free_points = plan.num_free_points;
  size.num_observations = plan.num_observations();
  size.num_pairs = static_cast<int64_t>(plan.pair_block.size());
  for (const Chunk& chunk : plan.chunks) {
    size.num_chunk_pairs += static_cast<int64_t>(chunk.pairs.size());
    size.num_chunk_images += static_cast<int64_t>(chunk.images.size());
    size.largest_chunk_blocks = std::max<int64_t>(size.largest_chunk_blocks, chunk.num_blocks());
  }
  size.block_doubles = block_doubles;
  return size;
}

}  // namespace bundle::fused
