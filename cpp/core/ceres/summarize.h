#pragma once

/// Conversion of Ceres' iterations and summary to ours.

#include <atomic>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/ceres/step_lengths.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Statistics of the factor of Ceres' linear solver `type`, as it was used. Ceres does not report
/// them. Sparse factors are counted here, on the pattern that Ceres builds and in CHOLMOD's AMD
/// order of its blocks. Ceres uses the same kind of order but numbers the blocks differently, and
/// may keep the groups of the ordering separate. So its factor can be some per cent larger or
/// smaller. The symbolic time is that of this count.
FactorSummary CountCeresFactor(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type);

/// Converts the summary of Ceres. `fixed_cost` is the cost of observations that are not in Ceres'
/// problem; it is added to every cost.
SolveSummary Summarize(const ceres::Solver::Summary& summary, double fixed_cost);

/// Returns a warning for each linear solver or preconditioner that Ceres replaced.
std::vector<Warning> FindFallbacks(const ceres::Solver::Summary& summary);

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost,
                         const StepLengths& lengths);

/// Reports each iteration and tests for an interruption. `abandoned` is true if a candidate could
/// not be evaluated because the user ended the solve; such a step is not reported.
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

/// Prepends the summary of a solve to that of the next solve, which continued from its end.
/// `repeats`: the first iteration of the next solve repeats the last one and is left out.
void PutBefore(const ceres::Solver::Summary& first, bool repeats, ceres::Solver::Summary* next);

/// Removes a step that could not be evaluated from the summary.
void ForgetAbandonedStep(ceres::Solver::Summary* summary);

}  // namespace bundle
