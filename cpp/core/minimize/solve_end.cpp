#include "core/minimize/solve_end.h"

#include <utility>

#include "core/parallel/thread_pool.h"

namespace bundle {

bool SolveEnd::MayEnd(double decrease, double cost, bool meets_function_tolerance) {
  has_decrement_ = false;
  return rule_.MayEnd(decrease, cost, meets_function_tolerance);
}

bool SolveEnd::Ends(double cost) {
  return rule_.Ends(CanMeasure() ? Measure(cost) : NewtonDecrement{}, cost);
}

void SolveEnd::JudgeState(const IterationRecord& record) {
  constexpr double kRounding = 1e-12;
  const double cost = problem_.CostOfAll();
  const bool is_start = record.iteration == 0 || (minimum_.is_best && !has_state_);
  has_state_ = true;
  if (!is_start && cost > (1 + kRounding) * minimum_.best_cost_of_all) {
    if (std::exchange(minimum_.is_best, false)) problem_.KeepPrevious();
    return;
  }
  minimum_.is_best = true;
  minimum_.best_cost_of_all = cost;
  minimum_.best_cost = record.cost;
}

void SolveEnd::Finish(double cost) {
  if (!minimum_.HasConverged()) {
    SetDistance({}, cost);
    if (minimum_.termination_type == "FAILURE" || minimum_.is_best) return;
    problem_.ReturnToKept();
    minimum_.returned_to_best = true;
    return;
  }
  if (!CanMeasure() || has_decrement_) return;
  try {
    problem_.Linearize(LeastSquares::kDecrementDamping);
    Measure(cost);
  } catch (const Interrupted&) {  // it is not needed
  }
}

NewtonDecrement SolveEnd::Measure(double cost) {
  const NewtonDecrement decrement = problem_.Decrement();
  SetDistance(decrement, cost);
  has_decrement_ = true;
  return decrement;
}

void SolveEnd::SetDistance(const NewtonDecrement& decrement, double cost) {
  const double sigma = rule_.Sigma(cost);
  minimum_.distance_in_sigmas = decrement.all / sigma;
  minimum_.largest_camera_step_in_sigmas = decrement.cameras / sigma;
}

}  // namespace bundle
