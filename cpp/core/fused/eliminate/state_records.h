#pragma once

/// The states and steps of a solve in the form that the passes read (kernels.h).

#include <vector>

#include "core/fused/eliminate/held_residuals.h"
#include "core/fused/eliminate/kernels.h"
#include "core/problem/problem_view.h"
#include "core/solve/camera_states.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

/// One state: the camera side as a vector of the layout, expanded, and the points of the plan.
class State {
 public:
  State(const ProblemView& problem, const ParameterLayout& layout, const PointPlan& plan);

  /// Expands `camera_side`, after it changed.
  void Update();
  StateRecords records() const;
  /// Of a candidate for the state after `before`, for a pass over one chunk that fills `held`.
  StateRecords CandidateRecords(const StateRecords& before, int chunk);
  const CameraStates& cameras() const { return cameras_; }

  std::vector<double> camera_side;
  std::vector<double> points;  ///< three a point of the plan
  HeldResiduals held;

 private:
  const ProblemView& problem_;
  CameraStates cameras_;
  std::vector<double> images_;
  int stride_;
};

/// Images' records of a step of the camera side, at a state.
class Step {
 public:
  Step(const ProblemView& problem, const ParameterLayout& layout);

  void Set(const std::vector<double>& camera_side, const CameraStates& at);
  StepRecords records() const { return {images_.data(), stride_}; }

 private:
  const ProblemView& problem_;
  const ParameterLayout& layout_;
  std::vector<double> poses_;
  std::vector<double> camera_params_;
  std::vector<double> images_;
  int stride_;
};

}  // namespace bundle::fused
