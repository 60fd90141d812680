#pragma once

/// Translation of our options to those of Ceres.

#include <memory>

#include "core/ceres/ceres_version.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/blas.h"

namespace bundle {

/// Makes the elimination order for one solve; Ceres changes it, so that each solve needs its own.
/// Group 0 is eliminated first: the points, or the images' blocks for kCamerasFirst. All other
/// blocks are group 1. nullptr for kAutomatic. The parameter blocks are in `points` and `state`.
std::shared_ptr<ceres::ParameterBlockOrdering> MakeOrdering(EliminationOrdering ordering,
                                                            const AdjustmentProblem& problem,
                                                            const ParameterLayout& layout,
                                                            double* points, double* state);

/// True if a factor has several unknowns of the kind that the ordering eliminates first (points, or
/// blocks of the layout). Group 0 then cannot contain all unknowns of this kind.
bool FactorsCoupleFirstGroup(EliminationOrdering ordering, const AdjustmentProblem& problem,
                             const ParameterLayout& layout);

/// True if group 0 would be empty although group 1 is not. Ceres then ignores the ordering and
/// finds an independent set itself.
bool NothingToEliminate(EliminationOrdering ordering, const ParameterLayout& layout);

/// Settings of the whole process, changed while Ceres runs and restored afterwards: the log is
/// silent (the summary has its contents), and OpenBLAS uses `blas_threads` threads.
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

/// The only function that converts our options to those of Ceres. `options.linear_solver_type` is
/// not kAuto; the ordering is set separately (MakeOrdering).
///
/// Throws InputError for every combination that Ceres would refuse, abort on, or replace silently.
ceres::Solver::Options TranslateOptions(const SolveOptions& options);

}  // namespace bundle
