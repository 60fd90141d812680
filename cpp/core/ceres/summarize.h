#pragma once

/// What a solve by Ceres reports, in our words: iterations as they end, and the summary.

#include <atomic>
#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// What Ceres factorises with the linear solver that it used, `type`. Ceres does not report
/// it: sparse factors are counted here, on the pattern that Ceres builds and in CHOLMOD's AMD order
/// of its blocks. Ceres asks CHOLMOD for the same kind of order but numbers the blocks its own way
/// and may have it keep the groups of the ordering apart, so that its factor can be some per cent
/// larger or smaller. The symbolic time is that of this count.
FactorSummary CountCeresFactor(const ProblemView& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type);

/// Ceres' summary in our words. `fixed_cost` is the cost of observations that Ceres never saw; it
/// is added to every cost.
SolveSummary Summarize(const ceres::Solver::Summary& summary, double fixed_cost);

/// A warning for each choice of a linear solver or of its preconditioner that Ceres did not keep.
std::vector<Warning> FindFallbacks(const ceres::Solver::Summary& summary);

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost);

/// Reports each iteration and looks for an interruption. `abandoned` is set where a candidate could
/// not be evaluated because the user ended the solve: such a step is not reported.
class ReportProgress final : public ceres::IterationCallback {
 public:
  ReportProgress(const ProgressCallback& progress, double fixed_cost,
                 const std::atomic<bool>& abandoned)
      : progress_(progress), fixed_cost_(fixed_cost), abandoned_(abandoned) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override;

  bool interrupted() const { return interrupted_; }

 private:
  const ProgressCallback& progress_;
  const double fixed_cost_;
  const std::atomic<bool>& abandoned_;
  bool interrupted_ = false;
};

/// Removes a step that could not be evaluated from the summary, as if it had not been tried.
void ForgetAbandonedStep(ceres::Solver::Summary* summary);

}  // namespace bundle
