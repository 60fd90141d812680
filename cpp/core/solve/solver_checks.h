#pragma once

/// What goes with a linear solver and what does not, whichever backend it belongs to.

#include <string>

#include "core/solve/options.h"
#include "core/solve/problem_shape.h"

namespace bundle {

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
