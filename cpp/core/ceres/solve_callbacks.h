#pragma once

/// Callbacks of a solve by Ceres: the states of its evaluations, and records of its iterations.

#include <memory>
#include <vector>

#include "core/ceres/active_bounds.h"
#include "core/ceres/ceres_graph.h"
#include "core/ceres/ceres_version.h"
#include "core/ceres/reprojection_cost.h"
#include "core/ceres/step_lengths.h"
#include "core/interface/summary.h"
#include "core/model/camera_states.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// Expands the camera parameters once per evaluation. Tests for an interruption before a candidate
/// is evaluated: within a step, this is the only time when Ceres can end with the best state. After
/// an interruption no cost can be evaluated, so that Ceres rejects the candidate.
class UpdateCameraStates final : public ceres::EvaluationCallback {
 public:
  UpdateCameraStates(const double* state, CameraStates* states, HoldingWatch* watch,
                     ActiveBounds* bounds, StepLengths* lengths, Abandonment* abandonment)
      : state_(state),
        states_(states),
        watch_(watch),
        bounds_(bounds),
        lengths_(lengths),
        abandonment_(abandonment) {}

  void PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) override {
    if (!evaluate_jacobians && InterruptionRequested())
      abandonment_->happened.store(true, std::memory_order_relaxed);
    if (new_evaluation_point) states_->Update(state_);
    // When Ceres asks for derivatives, it has already evaluated the cost at this state, except at
    // the first.
    const bool is_at_state = evaluate_jacobians && !(new_evaluation_point && has_start_);
    watch_->is_at_start.store(is_at_state && !has_start_ && all_count_);
    has_start_ = has_start_ || evaluate_jacobians;
    lengths_->Evaluate(is_at_state);
    watch_->is_at_candidate.store(true);  // no evaluation of ours is one at a state
    if (is_at_state) {
      states_->MoveAnchors();
      bounds_->Find();
    }
    watch_->is_at_candidate.store(!is_at_state);
    (is_at_state ? watch_->state_cost : watch_->candidate_cost).store(0);
    if (is_at_state) watch_->cost_if_all_count.store(0);
  }

  /// Call before a solve. `all_count`: at its start, all valid observations count.
  void BeginSolve(bool all_count) {
    has_start_ = false;
    all_count_ = all_count;
    watch_->has_changed.store(false);
  }

 private:
  const double* state_;
  CameraStates* states_;
  HoldingWatch* watch_;
  ActiveBounds* bounds_;
  StepLengths* lengths_;
  Abandonment* abandonment_;
  bool has_start_ = false;  ///< the derivatives at the start
  bool all_count_ = true;
};

/// Records for each iteration if other observations counted at the candidate than at the state, and
/// the held cost that is included in its cost. Iterations are numbered over several solves, each of
/// which continues from the end of the previous one.
class RecordHolding final : public ceres::IterationCallback {
 public:
  explicit RecordHolding(HoldingWatch* watch) : watch_(watch) {}

  /// `repeats`: the next solve begins with the last iteration of the previous one.
  void BeginSolve(bool repeats) {
    if (repeats) records_.pop_back();
    first_ = static_cast<int>(records_.size());
    changes_ = !repeats && first_ > 0;
  }

  /// Removes iterations of the current solve that are not in its summary.
  void EndSolve(size_t num_iterations) { records_.resize(first_ + num_iterations); }

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    const bool is_at_state = iteration.step_is_successful || !iteration.step_is_valid;
    const double held = is_at_state ? watch_->state_cost : watch_->candidate_cost;
    const bool changed = watch_->has_changed.exchange(false);
    records_.push_back({changed || (changes_ && iteration.iteration == 0), held});
    return ceres::SOLVER_CONTINUE;
  }

  /// True if the set of observations that count has changed since the last iteration.
  bool HasChanged() const { return records_.back().changed; }

  /// Completes the record of an iteration of the current solve, and numbers it among the iterations
  /// of all solves.
  void CompleteCurrent(IterationRecord* record) const {
    record->iteration += first_;
    Complete(record);
  }
  void Complete(IterationRecord* record) const {
    if (record->iteration >= static_cast<int>(records_.size())) return;
    const Record& known = records_[record->iteration];
    record->changes_what_counts = known.changed;
    record->cost -= known.held_cost;
  }

 private:
  struct Record {
    bool changed;
    double held_cost;
  };

  HoldingWatch* watch_;
  std::vector<Record> records_;
  int first_ = 0;
  bool changes_ = false;
};

/// Records the anchors of the state with which Ceres ends: the best state, or the start if the
/// solve fails. Ceres may evaluate later states that are worse than the best one by rounding
/// errors.
class RememberAnchors final : public ceres::IterationCallback {
 public:
  explicit RememberAnchors(const CameraStates& states)
      : states_(states), start_(states.anchors()), best_(start_) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    const bool is_best = iteration.step_is_successful && !iteration.step_is_nonmonotonic;
    if (is_best) best_ = states_.anchors();
    return ceres::SOLVER_CONTINUE;
  }

  const std::shared_ptr<const PoseAnchors>& AtEnd(const ceres::Solver::Summary& summary) const {
    return summary.IsSolutionUsable() ? best_ : start_;
  }

 private:
  const CameraStates& states_;
  const std::shared_ptr<const PoseAnchors> start_;
  std::shared_ptr<const PoseAnchors> best_;
};

}  // namespace bundle
