#pragma once

#include <string>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/prepare/prepare.h"
#include "core/problem/problem_view.h"

namespace bundle {

struct BackendChoice {
  Backend backend = Backend::kCeres;  ///< not kAuto
  std::string reason;                 ///< one sentence; "" where the backend was asked for
};

/// Chooses the backend: the fused one for what it supports, unless another was asked for.
///
/// Throws InputError if the fused backend was asked for what it does not support; the message names
/// the option.
BackendChoice ChooseBackend(const SolveOptions& options, const PreparedSolve& prepared);

/// Bundle adjustment by the backend that the options ask for. The problem is valid
/// (problem_view.h).
///
/// Throws InputError if a camera model is not supported, an id to be fixed does not exist, options
/// exclude each other or the backend, or the dense matrices of the solver would not fit into
/// memory. Anything else that keeps the solve from converging is in the summary.
SolveOutput Solve(const ProblemView& problem, const SolveOptions& options,
                  const ProgressCallback& progress);

}  // namespace bundle
