#pragma once

/// Our options as those of Ceres.

#include <memory>

#include "core/ceres/ceres_version.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/blas.h"

namespace bundle {

/// The elimination order for one solve, made anew each time because Ceres changes what it is given.
/// Group 0 is eliminated first: the points, or the images' blocks for kCamerasFirst; everything
/// else is group 1. nullptr for kAutomatic. `points` and `state` are where the parameter blocks
/// live.
std::shared_ptr<ceres::ParameterBlockOrdering> MakeOrdering(EliminationOrdering ordering,
                                                            const AdjustmentProblem& problem,
                                                            const ParameterLayout& layout,
                                                            double* points, double* state);

/// True if factors couple unknowns of one kind, so that some of them are not in the group that an
/// ordering eliminates.
bool FactorsCoupleFirstGroup(EliminationOrdering ordering, const AdjustmentProblem& problem,
                             const ParameterLayout& layout);

/// True if group 0 would be empty although group 1 is not. Ceres then takes the one group for no
/// ordering at all and finds an independent set by itself.
bool NothingToEliminate(EliminationOrdering ordering, const ParameterLayout& layout);

/// Settings that belong to the whole process, held while Ceres runs and given back afterwards: its
/// log prints nothing (the summary says it), and OpenBLAS uses `blas_threads` threads.
class ProcessSettings {
 public:
  explicit ProcessSettings(int blas_threads);
  ~ProcessSettings();
  ProcessSettings(const ProcessSettings&) = delete;
  ProcessSettings& operator=(const ProcessSettings&) = delete;

 private:
  ScopedBlasThreads blas_threads_;
};

/// Ceres' name of a linear solver. `type` is not kAuto.
ceres::LinearSolverType ToCeres(LinearSolverType type);

/// The one place where our options become Ceres'. `options.linear_solver_type` is not kAuto; the
/// ordering is set separately (MakeOrdering).
///
/// Throws InputError for every combination that Ceres would refuse, abort on, or quietly replace.
ceres::Solver::Options TranslateOptions(const SolveOptions& options);

}  // namespace bundle
