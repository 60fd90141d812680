#pragma once

#include <string>

#include "core/solve/options.h"
#include "core/solve/problem_shape.h"

namespace bundle {

struct SolverChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;  ///< one sentence
};

/// Chooses a linear solver for points eliminated first.
SolverChoice ChooseLinearSolver(const ProblemView& problem, const ParameterLayout& layout,
                                const ProblemShape& shape);

}  // namespace bundle
