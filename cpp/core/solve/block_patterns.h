#pragma once

#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"
#include "core/symbolic/block_pattern.h"

namespace bundle {

/// The reduced camera system S: a block of the layout each, as FindCoupledBlocks says.
BlockPattern ReducedPattern(const ProblemView& problem, const ParameterLayout& layout);

/// The information matrix J^T J of the whole problem: the free points in the order of the problem,
/// 3 x 3 each, then the blocks of the layout.
BlockPattern FullPattern(const ProblemView& problem, const ParameterLayout& layout);

}  // namespace bundle
