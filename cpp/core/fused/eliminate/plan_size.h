#pragma once

/// The sizes that decide what the passes over the points cost, without a pass.

#include <cstdint>

#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

struct PlanSize {
  int64_t num_points = 0;
  int64_t num_free_points = 0;
  int64_t num_observations = 0;
  /// Pairs of observations of a free point, both of images with something to refine.
  int64_t num_pairs = 0;
  /// Sums over the chunks: pairs of images that are added to S, and images with their diagonal
  /// blocks.
  int64_t num_chunk_pairs = 0;
  int64_t num_chunk_images = 0;
  int64_t largest_chunk_blocks = 0;
  int64_t block_doubles = 0;  ///< of a block in a chunk's buffer
};

PlanSize MeasurePlan(const ProblemView& problem, const ParameterLayout& layout);

}  // namespace bundle::fused
