#pragma once

/// How a solve by Ceres is told of, and left early with the best state.

#include <atomic>

#include "core/ceres/ceres_version.h"
#include "core/solve/solve.h"

namespace bundle {

/// Tells of each iteration and looks for an interruption. `abandoned` is set where a candidate
/// could not be evaluated because the user wants the solve to end: there is nothing to tell of.
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

/// Makes a step that could not be evaluated one that was never tried.
void ForgetAbandonedStep(ceres::Solver::Summary* summary);

}  // namespace bundle
