#pragma once

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"

namespace bundle {

/// Observations grouped by point: those of point p are in images[starts[p]] to images[starts[p + 1]
/// - 1], in the order of the problem.
struct Tracks {
  std::vector<int64_t> starts;  ///< num_points + 1
  std::vector<int32_t> images;  ///< of each observation
};

Tracks GroupByPoint(const ProblemView& problem);

/// The number of observations of each point.
std::vector<int64_t> TrackLengths(const ProblemView& problem);

}  // namespace bundle
