#pragma once

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/held_residuals.h"
#include "core/schur/kernels/kernels.h"
#include "core/scratch/large_vector.h"
#include "core/sums/double_double.h"

namespace bundle {

/// The states and steps of a solve in the form that the passes read (kernels.h).

/// Space of a shutter at the end of a record: twist, row scale.
inline constexpr int kShutter = kTwistSize + 2;

/// One state: the camera parameters as a vector of the layout, their expanded form, and the points
/// of the plan.
class State {
 public:
  State(const AdjustmentProblem& problem, const ParameterLayout& layout,
        const EliminationPlan& plan);

  /// Resets to the problem's own values, after these changed.
  void Reset(const ParameterLayout& layout, const EliminationPlan& plan);
  /// Expands `camera_state`, after it changed.
  void Update();
  /// Moves the anchors of images that have moved too far from them (factors/reprojection.h). The
  /// state does not change.
  void MoveAnchors();
  /// Call before the Update of a candidate: its step starts from `state`.
  void ShareAnchors(const State& state) { cameras_.SetAnchors(state.cameras_.anchors()); }
  StateRecords records() const;
  /// Records of a candidate whose step starts from `before`, for a pass over one chunk that fills
  /// `held`.
  StateRecords CandidateRecords(const StateRecords& before, int chunk);
  const CameraStates& cameras() const { return cameras_; }
  /// Returns all points of the problem, in its order.
  LargeVector<double> AllPoints(const EliminationPlan& plan) const;
  DoubleDouble FreePointsSquared(const EliminationPlan& plan) const;

  std::vector<double> camera_state;
  LargeVector<double> points;  ///< three numbers per point of the plan
  HeldResiduals held;

 private:
  void PutFrameChart(const RigPose& rig, double* record) const;
  void ForgetRowTimes();

  const AdjustmentProblem& problem_;
  const bool has_sensor_maps_;  ///< a sensor is refined
  CameraStates cameras_;
  std::vector<double> images_;
  LargeVector<double> row_times_;  ///< StateRecords::row_times
  int stride_;
};

/// Records of the images for a step of the camera parameters, at a state.
class CameraStep {
 public:
  CameraStep(const AdjustmentProblem& problem, const ParameterLayout& layout);

  void Set(const std::vector<double>& camera_state, const CameraStates& at);
  StepRecords records() const {
    const bool has_twists = !problem_.row_scale.empty();
    return {has_twists ? stride_ - kShutter : 0, images_.data(), stride_};
  }

 private:
  void SetOnRig(int image, const RigPose& rig, double* record) const;
  void SetHardTwist(int image, const TwistMap& map, double* step) const;
  const double* PoseStep(int pose) const {
    return poses_.data() + static_cast<int64_t>(pose) * kPoseSize;
  }

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  std::vector<double> poses_;  ///< zero for constant poses
  std::vector<double> camera_params_;
  std::vector<double> twists_, readouts_;
  std::vector<double> images_;
  int stride_;
};

}  // namespace bundle
