#pragma once

#include "core/solve/prepare.h"
#include "core/solve/solve.h"

namespace bundle::fused {

/// Bundle adjustment by the fused backend of what PrepareSolve made of the problem. The options and
/// the layout are such that ChooseBackend takes them.
///
/// Throws InputError if options exclude each other or the dense matrices of the solver would not
/// fit into memory. Anything else that keeps the solve from converging is in the summary.
SolveOutput SolveWithFused(const ProblemView& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress);

}  // namespace bundle::fused
