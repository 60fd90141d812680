#pragma once

/// Camera parameters of a problem at one state of a solve.

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "core/factors/reprojection.h"
#include "core/factors/rig_pose.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// One anchor per pose (factors/reprojection.h).
using PoseAnchors = std::vector<PoseAnchor>;

/// The camera parameters of a problem at one state, expanded once per evaluation so that an
/// observation only reads them: rotation, translation and left Jacobian of each image, its shutter,
/// parameters of each camera. Poses of rig images follow from their frames and sensors
/// (factors/rig_pose.h) and are given in the local coordinates of that file.
///
/// A state is defined relative to its anchors: a candidate needs the anchors of the state from
/// which its step starts.
class CameraStates {
 public:
  /// Keeps references to both; starts at the problem's own values.
  CameraStates(const AdjustmentProblem& problem, const ParameterLayout& layout);

  /// Resets to the problem's own values, after these changed.
  void Reset();

  void Update(const double* state);

  /// Sets a new anchor, at the current pose, for each pose that is too far from its anchor. The
  /// state and the poses do not change. True if any anchor moved; other poses keep every bit.
  bool MoveAnchors();
  /// Sets the anchors that are used from the next Update on. Anchor objects are never changed, only
  /// replaced.
  void SetAnchors(std::shared_ptr<const PoseAnchors> anchors) { anchors_ = std::move(anchors); }
  const std::shared_ptr<const PoseAnchors>& anchors() const { return anchors_; }

  /// Pose of an image, a frame or a sensor, by its number (NumPoses).
  const PoseState& pose(int pose) const { return poses_[pose]; }
  /// Frame and sensor from which the pose of an image follows.
  RigPose rig(int image) const;
  /// Shutter of an image; nullptr: global.
  const ImageShutter* shutter(int image) const {
    return problem_.HasRollingShutter(image) ? &shutters_[image] : nullptr;
  }
  const double* twist(int image) const { return shutters_[image].twist; }
  /// Derivatives of a hard-tied twist; nullptr if it is not.
  const TwistMap* twist_map(int image) const {
    return layout_.HasHardTwist(image) ? &twist_maps_[image] : nullptr;
  }
  const double* readout(int camera) const { return &readouts_[camera]; }
  const double* params(int camera) const {
    return camera_params_.data() + static_cast<int64_t>(camera) * stride_;
  }

  /// Chart of an image's observations: its anchor rotation, and (v, t), six numbers. For an image
  /// of a rig, the chart is at the image's current rotation.
  const double* chart_rotation(int image) const;
  void Chart(int image, double* chart) const;

  /// The refined poses as quaternion and translation (num_images x 7): Exp(v) q_a. A pose that did
  /// not move keeps every bit of its input.
  std::vector<double> CamFromWorld() const;
  /// Refined poses of frames and of sensors.
  std::vector<double> RigFromWorld() const;
  std::vector<double> SensorFromRig() const;
  /// Refined pose of one image, frame or sensor, by its number.
  void ValueOf(int pose, double value[7]) const;
  const std::vector<double>& camera_params() const { return camera_params_; }
  /// Refined twists and readouts; empty if all shutters are global.
  std::vector<double> Twists() const;
  const std::vector<double>& readouts() const { return readouts_; }

 private:
  void ResetShutters();
  void FollowPoses();
  void Expand();
  void TurnAboutCentre(int image);
  void ChartOf(int pose, double* chart) const;
  bool HasMoved(int pose) const;
  /// ValueOf a pose that is a variable itself.
  void ValueOfVariable(int pose, double value[7]) const;
  std::vector<double> Values(int first, int count) const;

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const int stride_;
  std::shared_ptr<const PoseAnchors> anchors_;
  std::vector<double> charts_;  ///< (w, t) of each pose
  std::vector<PoseState> poses_;
  std::vector<double> camera_params_;
  std::vector<ImageShutter> shutters_;  ///< per image; empty if all are global
  std::vector<double> twists_, readouts_;
  std::vector<TwistMap> twist_maps_;  ///< per image; empty if no twist is hard-tied
};

}  // namespace bundle
