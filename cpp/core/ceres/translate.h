#pragma once

/// Between us and Ceres: our options as Ceres' (translate_options.cpp), its iterations and summary
/// as ours (summarize.cpp).

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/ceres/step_lengths.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/blas.h"

namespace bundle {

/// rho(s), s = ||r||^2, bending where ||r|| reaches `scale` pixels; nullptr for the trivial loss,
/// which Ceres then skips.
std::unique_ptr<ceres::LossFunction> MakeLoss(LossType type, double scale);

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

/// What Ceres factorises with the linear solver that it used, `type`. Ceres does not report
/// it: sparse factors are counted here, on the pattern that Ceres builds and in CHOLMOD's AMD order
/// of its blocks. Ceres asks CHOLMOD for the same kind of order but numbers the blocks its own way
/// and may have it keep the groups of the ordering apart, so that its factor can be some per cent
/// larger or smaller. The symbolic time is that of this count.
FactorSummary CountCeresFactor(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type);

/// Ceres' summary in our words. `fixed_cost` is the cost of observations that Ceres never saw; it
/// is added to every cost.
SolveSummary Summarize(const ceres::Solver::Summary& summary, double fixed_cost);

/// A lower bound of what the cost would fall by, by its linearisation, after a step that was
/// accepted and another that met the parameter tolerance; 0 after any other end. The problem is
/// where Ceres left it.
double UntakenDecrease(const ceres::Solver::Summary& summary, ceres::Problem* problem);

/// A warning for each choice of a linear solver or of its preconditioner that Ceres did not keep.
std::vector<Warning> FindFallbacks(const ceres::Solver::Summary& summary);

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost,
                         const StepLengths& lengths);

/// Reports each iteration and looks for an interruption. `abandoned` is set where a candidate could
/// not be evaluated because the user ended the solve: such a step is not reported.
class ReportProgress final : public ceres::IterationCallback {
 public:
  ReportProgress(const ProgressCallback& progress, double fixed_cost, const StepLengths& lengths,
                 const std::atomic<bool>& abandoned)
      : progress_(progress), fixed_cost_(fixed_cost), lengths_(lengths), abandoned_(abandoned) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override;

  bool interrupted() const { return interrupted_; }

 private:
  const ProgressCallback& progress_;
  const double fixed_cost_;
  const StepLengths& lengths_;
  const std::atomic<bool>& abandoned_;
  bool interrupted_ = false;
};

/// Puts the summary of a solve in front of that of the next, which went on from its end and is left
/// out where it says the same: `repeats`, at its start.
void PutBefore(const ceres::Solver::Summary& first, bool repeats, ceres::Solver::Summary* next);

/// Removes a step that could not be evaluated from the summary, as if it had not been tried.
void ForgetAbandonedStep(ceres::Solver::Summary* summary);

}  // namespace bundle
