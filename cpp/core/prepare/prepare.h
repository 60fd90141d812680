#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// What every backend starts from.
struct PreparedSolve {
  ParameterLayout layout;
  std::vector<Warning> warnings;
  std::vector<int64_t> track_lengths;  ///< observations of each point
};

/// Decides what is free and how it is laid out. The problem is valid (problem_view.h).
///
/// Throws InputError if a camera model is not supported or an id to be fixed does not exist.
PreparedSolve PrepareSolve(const ProblemView& problem, const SolveOptions& options);

/// What goes with a linear solver and what does not, whichever backend it belongs to.

/// True for the solvers that have a preconditioner and no exact steps.
bool IsIterative(LinearSolverType type);

/// Throws InputError if the trust region needs exact steps and the linear solver, which is not
/// kAuto, has none.
void CheckTrustRegion(const SolveOptions& options);

/// One sentence if a preconditioner was asked for that the linear solver has no use for; else "".
std::string FindIdlePreconditioner(const SolveOptions& options);

/// One sentence if an elimination ordering was asked for of a linear solver that has none; else "".
std::string FindIdleOrdering(const SolveOptions& options);

/// True if `bytes` leave a tenth of the available memory to everything else.
bool FitsIntoMemory(double bytes, double available);

/// Throws InputError if the dense matrices of a solver do not fit into the free memory.
void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape, bool cameras_eliminated);

/// The same for matrices of so many bytes: `what` they are, and which solver to use `instead`.
void RefuseTooMuchMemory(LinearSolverType type, double bytes, const char* what,
                         const char* instead);

/// The same for a solver whose matrix takes so many bytes, beside those of observations and points.
void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes, double working_bytes = 0);

/// The same for what any solver of a backend keeps of the observations and points.
void RefuseTooMuchMemory(double working_bytes);

/// Throws InputError if there are more residuals or parameters than an int counts: Ceres numbers
/// them so, and so do the reports of both backends.
void RefuseTooLarge(const ProblemView& problem);

}  // namespace bundle
