#include "core/schur/elimination_plan.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/schur/cut_chunks.h"
#include "core/schur/image_parts.h"
#include "core/schur/point_entries.h"
#include "core/schur/sort_points.h"

namespace bundle {

namespace {

void MeasureTiles(const PointSizes& sizes, EliminationPlan* plan) {
  for (const Chunk& chunk : plan->chunks) {
    int first_point = chunk.first_point;
    for (const Tile& tile : chunk.tiles) {
      int entries = 0;
      for (int p = first_point; p < tile.last_point; ++p) entries += sizes.num_entries(p);
      plan->largest_tile_entries = std::max(plan->largest_tile_entries, entries);
      plan->largest_tile_points =
          std::max(plan->largest_tile_points, tile.last_point - first_point);
      plan->largest_tile_observations = std::max(
          plan->largest_tile_observations, plan->first[tile.last_point] - plan->first[first_point]);
      first_point = tile.last_point;
    }
  }
}

void LinkChunks(int num_own_parts, EliminationPlan* plan) {
  std::vector<int> last_chunk(num_own_parts, -1);
  for (size_t c = 0; c < plan->chunks.size(); ++c) {
    Chunk& chunk = plan->chunks[c];
    for (int i = 0; i < chunk.num_own_parts; ++i) {
      int& last = last_chunk[chunk.parts[i]];
      chunk.previous_chunk.push_back(last);
      last = static_cast<int>(c);
    }
  }
}

EliminationPlan Plan(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const ImageParts& parts, bool active, ThreadPool* pool, bool keep_order,
                     bool in_sections, bool has_pairs) {
  const ImageOrder images = OrderImages(problem, layout);
  EliminationPlan plan = SortPoints(problem, layout, images, active, in_sections, pool, keep_order);
  plan.has_pairs = has_pairs;
  plan.num_kinds = parts.num_kinds();
  const PointSizes sizes(plan, images, parts, pool);
  // Some ranks may have no points without free parameters.
  Communicator* const communicator = active ? problem.division.communicator : nullptr;
  CutIntoChunks(parts, sizes, in_sections, communicator, pool, &plan);
  MeasureTiles(sizes, &plan);
  LinkChunks(parts.num_own_parts(), &plan);
  return plan;
}

}  // namespace

EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageParts& parts, ThreadPool* pool, bool keep_order,
                           bool in_sections, bool has_pairs) {
  return Plan(problem, layout, parts, true, pool, keep_order, in_sections, has_pairs);
}

EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const ImageParts& parts, ThreadPool* pool, bool keep_order) {
  return Plan(problem, layout, parts, false, pool, keep_order, /*in_sections=*/false,
              /*has_pairs=*/true);
}

PlanSize MeasurePlan(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const ImageParts parts(problem, layout);
  const EliminationPlan plan = PlanPoints(problem, layout, parts);
  PlanSize size;
  size.num_points = plan.num_points();
  size.num_free_points = plan.num_free_points;
  size.num_observations = plan.num_observations();
  size.num_kinds = plan.num_kinds;
  for (const Chunk& chunk : plan.chunks) {
    size.num_pairs += static_cast<int64_t>(chunk.entry_pairs.size());
    size.num_tile_blocks += static_cast<int64_t>(chunk.tile_blocks.size());
    size.num_chunk_pairs += static_cast<int64_t>(chunk.pairs.size());
    size.num_chunk_parts += static_cast<int64_t>(chunk.parts.size());
    size.largest_chunk_blocks = std::max<int64_t>(size.largest_chunk_blocks, chunk.num_blocks());
  }
  size.block_doubles = parts.block_size();
  return size;
}

}  // namespace bundle
