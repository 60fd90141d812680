#pragma once

/// Preparation of a solve: from a problem and options to a layout. Refuses options that exclude
/// each other before any work is done.

#include <cstdint>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// Input of both backends.
struct PreparedSolve {
  ParameterLayout layout;
  std::vector<Warning> warnings;
  std::vector<int64_t> track_lengths;  ///< observations of each point
  int64_t num_free_points = 0;         ///< on all ranks
  int64_t longest_track = 0;           ///< on all ranks
  /// Name and property of the first factor that couples a point with something else, or that only
  /// Ceres evaluates; "": there is none.
  std::string factor_for_ceres;
};

/// Parameters that the options leave free and the gauge does not hold. The values of the problem
/// matter only for the gauge. Warns if the gauge could not be held as asked, or need not be held.
FreeParameters ChooseFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options,
                                    std::vector<Warning>* warnings);

/// Chooses the free parameters and their layout. The problem is valid (problem_view.h).
///
/// Throws InputError if a camera model is not supported or an id to be fixed does not exist.
PreparedSolve PrepareSolve(const AdjustmentProblem& problem, const SolveOptions& options);

/// True for the solvers that have a preconditioner and no exact steps.
bool IsIterative(LinearSolverType type);

/// Throws InputError if the trust region needs exact steps and the linear solver, which is not
/// kAuto, has none.
void CheckTrustRegion(const SolveOptions& options);

/// One sentence if a preconditioner was asked for that the linear solver has no use for; else "".
std::string FindIdlePreconditioner(const SolveOptions& options);

/// One sentence if an elimination ordering was asked for of a linear solver that has none; else "".
std::string FindIdleOrdering(const SolveOptions& options);

/// Throws InputError if there are more residuals or parameters than an int counts: Ceres numbers
/// them so, and so do the reports of both backends.
void RefuseTooLarge(const ProblemView& problem);

}  // namespace bundle
