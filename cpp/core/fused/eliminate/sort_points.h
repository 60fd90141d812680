#pragma once

#include <cstdint>
#include <vector>

#include "core/fused/eliminate/point_plan.h"
#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

struct ImageOrder {
  std::vector<uint8_t> refined;  ///< of each image: has something to refine
  /// Place of each image: refined ones in the order of their blocks, which S likes best, then the
  /// others.
  std::vector<int> rank;
};

ImageOrder OrderImages(const ProblemView& problem, const ParameterLayout& layout);

/// Everything of a plan but the chunks and what refers to them: the points with observations that
/// have something to refine, if `active`, or else with others, sorted lexicographically by the
/// ranks of the images in these observations.
PointPlan SortPoints(const ProblemView& problem, const ParameterLayout& layout,
                     const ImageOrder& images, bool active, int num_threads);

}  // namespace bundle::fused
