#pragma once

#include "core/solve/solve.h"

namespace bundle {

/// Bundle adjustment by Ceres. The problem is valid (validate.h).
///
/// Throws InputError if a camera model is not supported, an id to be fixed does not exist, options
/// exclude each other, or the dense matrices of the solver would not fit into memory. Anything else
/// that keeps the solve from converging is in the summary.
SolveOutput SolveWithCeres(const ProblemView& problem, const SolveOptions& options,
                           const ProgressCallback& progress);

/// "2.1.0"
const char* CeresVersion();

}  // namespace bundle
