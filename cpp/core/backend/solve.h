#pragma once

#include "core/problem/problem_view.h"
#include "core/solve/options.h"
#include "core/solve/solve.h"

namespace bundle {

/// Bundle adjustment by the backend that the options ask for. The problem is valid (validate.h).
///
/// Throws InputError if a camera model is not supported, an id to be fixed does not exist, options
/// exclude each other or the backend, or the dense matrices of the solver would not fit into
/// memory. Anything else that keeps the solve from converging is in the summary.
SolveOutput Solve(const ProblemView& problem, const SolveOptions& options,
                  const ProgressCallback& progress);

}  // namespace bundle
