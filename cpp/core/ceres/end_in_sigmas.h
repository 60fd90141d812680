#pragma once

/// End of a solve by Ceres in standard deviations (minimize/sigma_rule.h), and its best state.

#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/ceres/reprojection_cost.h"
#include "core/ceres/solve_callbacks.h"
#include "core/minimize/sigma_rule.h"
#include "core/model/camera_states.h"

namespace bundle {

/// Takes the step that meets the function tolerance, as minimize/trust_region.cpp does: Ceres ends
/// after a step that was accepted, by this callback. The function tolerance of Ceres itself must
/// then be kLostChange.
class EndInSigmas final : public ceres::IterationCallback {
 public:
  /// `dof`: those of SigmaRule. `ends`: false if something else ends the solve, by MayEnd.
  EndInSigmas(double dof, bool ends, double function_tolerance, const HoldingWatch& watch,
              const RecordHolding& records, std::function<NewtonDecrement()> measure)
      : rule_(dof),
        ends_(ends),
        tolerance_(function_tolerance),
        watch_(watch),
        records_(records),
        measure_(std::move(measure)) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    const double before = cost_;
    const bool is_start = iteration.iteration == 0;
    const bool is_accepted = iteration.step_is_successful;
    if (is_start || is_accepted) cost_ = iteration.cost - watch_.state_cost;
    if (is_start || !iteration.step_is_valid) return ceres::SOLVER_CONTINUE;
    const bool meets = ends_ && std::abs(iteration.cost_change) <= tolerance_ * before;
    const bool ended = is_accepted ? MayEnd(iteration, meets) : meets && !rule_.IsKnown();
    if (!ended) return ceres::SOLVER_CONTINUE;
    char text[96];
    std::snprintf(text, sizeof(text), "Function tolerance reached. |cost_change|/cost: %e <= %e",
                  std::abs(iteration.cost_change) / before, tolerance_);
    message_ = text;
    return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

  /// True if the solve may end with an accepted step.
  bool MayEnd(const ceres::IterationSummary& iteration, bool meets_function_tolerance) {
    const double cost = iteration.cost - watch_.state_cost;
    const double decrease =
        records_.HasChanged() ? std::numeric_limits<double>::quiet_NaN() : iteration.cost_change;
    is_measured_ = false;
    if (!rule_.MayEnd(decrease, cost, meets_function_tolerance)) return false;
    return rule_.Ends(Measure(cost), cost);
  }

  /// Measures the distance to the minimum at the end of the solve, unless it is known.
  void MeasureEnd(double cost) {
    if (!is_measured_) Measure(cost);
  }

  /// Message of the end by this callback; "" if something else ended the solve.
  const std::string& message() const { return message_; }
  bool takes_last_step() const { return ends_; }
  double distance() const { return distance_; }
  double camera_distance() const { return camera_distance_; }

 private:
  NewtonDecrement Measure(double cost) {
    if (!rule_.IsKnown()) return {};
    const NewtonDecrement decrement = measure_();
    distance_ = decrement.all / rule_.Sigma(cost);
    camera_distance_ = decrement.cameras / rule_.Sigma(cost);
    is_measured_ = true;
    return decrement;
  }

  SigmaRule rule_;
  const bool ends_;
  const double tolerance_;
  const HoldingWatch& watch_;
  const RecordHolding& records_;
  const std::function<NewtonDecrement()> measure_;
  double cost_ = 0;  ///< at the last state, without the held cost
  bool is_measured_ = false;
  double distance_ = std::numeric_limits<double>::quiet_NaN();
  double camera_distance_ = std::numeric_limits<double>::quiet_NaN();
  std::string message_;
};

/// Keeps the accepted state of the least cost of all observations (LeastSquares::CostOfAll). It
/// differs from the last state only if observations have held residuals.
class RememberBest final : public ceres::IterationCallback {
 public:
  RememberBest(const std::vector<double>& numbers, const CameraStates& states,
               const HoldingWatch& watch)
      : numbers_(numbers), states_(states), watch_(watch) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    constexpr double kRounding = 1e-12;
    if (iteration.iteration > 0 && !iteration.step_is_successful) return ceres::SOLVER_CONTINUE;
    const double cost = iteration.cost - watch_.state_cost;
    const double all = cost + watch_.cost_if_all_count;
    is_last_ = !(all > (1 + kRounding) * best_);
    if (!is_last_) return ceres::SOLVER_CONTINUE;
    best_ = all;
    cost_ = cost;
    held_cost_ = watch_.state_cost;
    num_held_ = watch_.num_held;
    anchors_ = states_.anchors();
    kept_.clear();
    if (num_held_ > 0) kept_ = numbers_;
    return ceres::SOLVER_CONTINUE;
  }

  /// True if a state before the last one is the best.
  bool IsEarlier() const { return !is_last_ && !kept_.empty(); }
  const std::vector<double>& numbers() const { return kept_; }
  const std::shared_ptr<const PoseAnchors>& anchors() const { return anchors_; }
  double cost() const { return cost_; }
  double held_cost() const { return held_cost_; }
  int64_t num_held() const { return num_held_; }

 private:
  const std::vector<double>& numbers_;
  const CameraStates& states_;
  const HoldingWatch& watch_;
  double best_ = std::numeric_limits<double>::infinity();
  double cost_ = 0, held_cost_ = 0;
  int64_t num_held_ = 0;
  bool is_last_ = true;
  std::vector<double> kept_;
  std::shared_ptr<const PoseAnchors> anchors_;
};

}  // namespace bundle
