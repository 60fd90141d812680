#pragma once

#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// The block pairs of the reduced camera system that some residual or free point couples:
/// columns[j] holds the blocks i >= j that meet block j, ascending, j first.
std::vector<std::vector<int>> FindCoupledBlocks(const ProblemView& problem,
                                                const ParameterLayout& layout, int num_threads = 1);

/// Those that a residual couples, whatever its point: a shared camera and the poses of its images.
std::vector<std::vector<int>> FindDirectlyCoupledBlocks(const ProblemView& problem,
                                                        const ParameterLayout& layout);

}  // namespace bundle
