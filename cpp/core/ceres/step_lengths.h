#pragma once

/// Lengths of steps, as Ceres 2.1 reports them. Ceres 2.2 reports 0 for each step up to the first
/// accepted step. It computes lengths only for the parameter tolerance, which it does not test
/// earlier. Until then, lengths are measured here: between the last state and a candidate, which
/// are in the user's memory when Ceres calls an EvaluationCallback.

#include <ceres/iteration_callback.h>

#include <cmath>
#include <cstddef>
#include <map>
#include <vector>

namespace bundle {

class StepLengths final : public ceres::IterationCallback {
 public:
  /// Adds numbers that a solve changes. They must not be moved.
  void Add(const double* values, size_t size) { values_.push_back({values, size}); }

  /// Call before another solve, whose iterations continue the numbering.
  void Restart() { has_accepted_ = false; }

  /// Removes the steps of an earlier solve.
  void BeginSolve() {
    measured_.clear();
    state_.clear();
    length_ = 0;
    has_accepted_ = false;
  }

  /// Call before each evaluation, with the values of the state or of a candidate in place.
  void Evaluate(bool is_at_state) {
    if (has_accepted_) return;
    if (is_at_state) {
      state_.clear();
      for (const Values& part : values_)
        state_.insert(state_.end(), part.data, part.data + part.size);
      return;
    }
    if (state_.empty()) return;  // Ceres evaluates residuals of constant blocks before the start
    double squared = 0;
    size_t k = 0;
    for (const Values& part : values_) {
      for (size_t i = 0; i < part.size; ++i, ++k) {
        const double change = part.data[i] - state_[k];
        squared += change * change;
      }
    }
    length_ = std::sqrt(squared);
  }

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    if (!has_accepted_) measured_[iteration.iteration] = length_;
    has_accepted_ = has_accepted_ || (iteration.iteration > 0 && iteration.step_is_successful);
    length_ = 0;  // a step that is not valid has no candidate
    return ceres::SOLVER_CONTINUE;
  }

  /// The length of a step, reported or measured.
  double Of(const ceres::IterationSummary& iteration) const {
    const auto found = measured_.find(iteration.iteration);
    return iteration.step_norm != 0 || found == measured_.end() ? iteration.step_norm
                                                                : found->second;
  }

 private:
  struct Values {
    const double* data;
    size_t size;
  };

  std::vector<Values> values_;
  std::vector<double> state_;
  std::map<int, double> measured_;
  double length_ = 0;
  bool has_accepted_ = false;
};

}  // namespace bundle
