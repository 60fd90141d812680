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
#include "core/scratch/large_vector.h"

namespace bundle {

/// Input of both backends.
struct PreparedSolve {
  ParameterLayout layout;
  std::vector<Warning> warnings;
  LargeVector<int64_t> track_lengths;  ///< observations of each point
  int64_t num_free_points = 0;         ///< on all ranks
  int64_t longest_track = 0;           ///< on all ranks
  /// Name and property of the first factor that couples a point with another free variable, or that
  /// only Ceres evaluates; "" without such a factor.
  std::string factor_for_ceres;
};

/// Parameters that the options leave free and the gauge does not hold constant. The values of the
/// problem matter only for the gauge. Warns if the gauge could not be fixed as requested, or need
/// not be fixed.
FreeParameters ChooseFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options,
                                    std::vector<Warning>* warnings);

/// Chooses the free parameters and their layout. The problem is valid (problem_view.h).
///
/// Throws InputError if a camera model is not supported or an id to be fixed does not exist.
PreparedSolve PrepareSolve(const AdjustmentProblem& problem, const SolveOptions& options);

/// True for solvers that have a preconditioner and only inexact steps.
bool IsIterative(LinearSolverType type);

/// Throws InputError if the trust region needs exact steps, but the linear solver, which is not
/// kAuto, has only inexact ones.
void CheckTrustRegion(const SolveOptions& options);

/// Returns a message if a preconditioner was requested that the linear solver does not use;
/// otherwise "".
std::string FindIdlePreconditioner(const SolveOptions& options);

/// Returns a message if an elimination ordering was requested that the linear solver does not use;
/// otherwise "".
std::string FindIdleOrdering(const SolveOptions& options);

/// Throws InputError if the number of residuals or parameters exceeds the range of int, which Ceres
/// and the reports of both backends use for them.
void RefuseTooLarge(const ProblemView& problem);

}  // namespace bundle
