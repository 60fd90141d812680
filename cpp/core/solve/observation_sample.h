#pragma once

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"

namespace bundle {

/// The indices, ascending, of about `size` observations, the same at each call: as many of each
/// camera model that observes anything, and of each image with that model as far as it has them.
/// Takes some 3 ns an observation of the problem.
std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size);

}  // namespace bundle
