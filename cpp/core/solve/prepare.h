#pragma once

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/warning.h"

namespace bundle {

/// What every backend starts from.
struct PreparedSolve {
  ParameterLayout layout;
  std::vector<Warning> warnings;
  std::vector<int64_t> track_lengths;  ///< observations of each point
};

/// Decides what is free and how it is laid out. The problem is valid (validate.h).
///
/// Throws InputError if a camera model is not supported or an id to be fixed does not exist.
PreparedSolve PrepareSolve(const ProblemView& problem, const SolveOptions& options);

}  // namespace bundle
