#pragma once

#include "core/ceres/ceres_version.h"
#include "core/solve/options.h"

namespace bundle {

/// Ceres' name of a linear solver. `type` is not kAuto.
ceres::LinearSolverType ToCeres(LinearSolverType type);

/// The one place where our options become Ceres'. `options.linear_solver_type` is not kAuto; the
/// ordering is set separately (ordering.h).
///
/// Throws InputError for every combination that Ceres would refuse, abort on, or quietly replace.
ceres::Solver::Options TranslateOptions(const SolveOptions& options);

}  // namespace bundle
