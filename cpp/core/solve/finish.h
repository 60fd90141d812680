#pragma once

#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/camera_states.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/solve.h"
#include "core/solve/warning.h"

namespace bundle {

/// What every backend ends with: looks at the iterations and the solution that a backend left in
/// `output`, says in its warnings, after `warnings`, what is wrong with them, and drops a solution
/// that is none. `states` is the camera side of the solution; `num_held` is the number of
/// observations that hold a residual there (residuals/held_residual.h).
void FinishSolve(const ProblemView& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output);

}  // namespace bundle
