#include "core/ceres/interruptible.h"

#include <algorithm>
#include <limits>

#include "core/ceres/summarize.h"
#include "core/interruption.h"

namespace bundle {

ceres::CallbackReturnType ReportProgress::operator()(const ceres::IterationSummary& iteration) {
  // An abandoned step is none to tell of.
  if (abandoned_) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  const bool goes_on = !progress_ || progress_(ToRecord(iteration, fixed_cost_));
  if (goes_on && !InterruptionRequested()) return ceres::SOLVER_CONTINUE;
  interrupted_ = true;
  return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
}

void ForgetAbandonedStep(ceres::Solver::Summary* summary) {
  const auto unfinished = [](const ceres::IterationSummary& iteration) {
    return iteration.iteration > 0 && !(iteration.cost < std::numeric_limits<double>::max());
  };
  if (unfinished(summary->iterations.back())) {
    summary->iterations.pop_back();
    --summary->num_unsuccessful_steps;
  }
  summary->termination_type = ceres::USER_SUCCESS;
  summary->message = "User callback returned SOLVER_TERMINATE_SUCCESSFULLY.";
  summary->final_cost = summary->initial_cost;
  for (const ceres::IterationSummary& iteration : summary->iterations) {
    summary->final_cost = std::min(summary->final_cost, iteration.cost);
  }
}

}  // namespace bundle
