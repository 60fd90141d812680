#include "core/model/camera_states.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "core/geometry/rotation.h"
#include "core/model/parameter_layout.h"

namespace bundle {

CameraStates::CameraStates(const AdjustmentProblem& problem, const ParameterLayout& layout)
    : problem_(problem),
      layout_(layout),
      stride_(problem.camera_params_stride),
      charts_(static_cast<size_t>(NumPoses(problem)) * kPoseSize),
      poses_(NumPoses(problem)) {
  Reset();
}

void CameraStates::Reset() {
  camera_params_.assign(
      problem_.camera_params,
      problem_.camera_params + static_cast<std::ptrdiff_t>(problem_.num_cameras) * stride_);
  std::fill(charts_.begin(), charts_.end(), 0.0);
  ResetShutters();
  const int num_poses = NumPoses(problem_);
  auto anchors = std::make_shared<PoseAnchors>(num_poses);
  for (int p = 0; p < num_poses; ++p) {
    const double* const pose = ValueOfPose(problem_, p);
    PoseAnchor& anchor = (*anchors)[p];
    std::fill_n(anchor.w, 3, 0.0);
    std::copy_n(pose, 4, anchor.quaternion);
    QuaternionToRotation(pose, anchor.rotation);
    std::copy(pose + 4, pose + 7, &charts_[kPoseSize * static_cast<size_t>(p) + 3]);
  }
  anchors_ = std::move(anchors);
  Update(layout_.InitialState(problem_).data());
}

void CameraStates::ResetShutters() {
  if (problem_.row_scale.empty()) return;
  readouts_.assign(problem_.readouts, problem_.readouts + problem_.num_cameras);
  twists_.assign(problem_.twists, problem_.TwistOf(problem_.num_images));
  shutters_.resize(problem_.num_images);
  if (layout_.HasHardTwists()) twist_maps_.resize(problem_.num_images);
  for (int i = 0; i < problem_.num_images; ++i) {
    std::copy_n(problem_.RowScaleOf(i), 2, shutters_[i].row_scale);
    shutters_[i].at_observed_row = problem_.at_observed_row;
  }
}

void CameraStates::Update(const double* state) {
  layout_.Scatter(problem_, state, charts_.data(), camera_params_.data(), twists_.data(),
                  readouts_.data());
  for (size_t i = 0; i < shutters_.size(); ++i) {
    std::copy_n(&twists_[kTwistSize * i], kTwistSize, shutters_[i].twist);
  }
  for (int i = 0; problem_.restrictions.held_pose_parts != nullptr && i < problem_.num_images;
       ++i) {
    if (TurnsAboutCentre(problem_, i)) TurnAboutCentre(i);
  }
  Expand();
}

/// t = -R c for the centre c at the problem's values. A pose that did not turn keeps its bits.
void CameraStates::TurnAboutCentre(int image) {
  const double* const start = ValueOfPose(problem_, image);
  double chart[kPoseSize], value[7], rotation[9], back[3];
  double* const translation = &charts_[kPoseSize * int64_t{image} + 3];
  ChartOf(image, chart);
  ValueOf(image, value);
  if (std::equal(value, value + 4, start)) {
    std::copy_n(start + 4, 3, translation);
    return;
  }
  QuaternionToRotation(start, rotation);
  VectorMatrix3(start + 4, rotation, back);  // R^T t = -c
  PoseState pose;
  ExpandPose((*anchors_)[image].rotation, chart, &pose);
  MatrixVector3(pose.rotation, back, translation);
}

void CameraStates::Expand() {
  for (int p = 0; p < NumPoses(problem_); ++p) {
    if (p < problem_.num_images && problem_.FrameOf(p) >= 0) continue;
    double chart[kPoseSize];
    ChartOf(p, chart);
    ExpandPose((*anchors_)[p].rotation, chart, &poses_[p]);
  }
  FollowPoses();
  if (problem_.num_frames == 0) return;
  for (int i = 0; i < problem_.num_images; ++i) {
    if (const RigPose of = rig(i); of.frame != nullptr) ComposePose(of, &poses_[i]);
  }
}

void CameraStates::FollowPoses() {
  for (size_t i = 0; i < twist_maps_.size(); ++i) {
    const auto image = static_cast<int>(i);
    if (!layout_.HasHardTwist(image)) continue;
    const int a = problem_.twist_neighbours[2 * i], b = problem_.twist_neighbours[2 * i + 1];
    double before[7], after[7];
    ValueOf(a, before);
    ValueOf(b, after);
    NormalizeQuaternion(before);
    NormalizeQuaternion(after);
    HardTwist(before, after, poses_[a], poses_[b],
              problem_.image_frames[b] - problem_.image_frames[a],
              readouts_[problem_.image_camera[image]], shutters_[i].twist, &twist_maps_[i]);
  }
}

RigPose CameraStates::rig(int image) const {
  const int frame = problem_.FrameOf(image), sensor = problem_.SensorOf(image);
  if (frame < 0) return {};
  return {&poses_[PoseOfFrame(problem_, frame)],
          sensor < 0 ? nullptr : &poses_[PoseOfSensor(problem_, sensor)]};
}

bool CameraStates::MoveAnchors() {
  std::shared_ptr<PoseAnchors> moved;
  for (int p = 0; p < NumPoses(problem_); ++p) {
    double v[kPoseSize], pose[7];
    ChartOf(p, v);
    if (!(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > kMaxChartAngle * kMaxChartAngle)) continue;
    if (moved == nullptr) moved = std::make_shared<PoseAnchors>(*anchors_);
    ValueOf(p, pose);
    PoseAnchor& anchor = (*moved)[p];
    std::copy_n(&charts_[kPoseSize * int64_t{p}], 3, anchor.w);
    std::copy_n(pose, 4, anchor.quaternion);
    QuaternionToRotation(pose, anchor.rotation);
  }
  if (moved == nullptr) return false;
  anchors_ = std::move(moved);
  Expand();
  return true;
}

void CameraStates::ChartOf(int pose, double* chart) const {
  std::copy_n(&charts_[kPoseSize * int64_t{pose}], kPoseSize, chart);
  for (int j = 0; j < 3; ++j) chart[j] -= (*anchors_)[pose].w[j];
}

const double* CameraStates::chart_rotation(int image) const {
  return problem_.FrameOf(image) < 0 ? (*anchors_)[image].rotation : poses_[image].rotation;
}

void CameraStates::Chart(int image, double* chart) const {
  if (problem_.FrameOf(image) < 0) {
    ChartOf(image, chart);
    return;
  }
  std::fill_n(chart, 3, 0.0);
  std::copy_n(poses_[image].translation, 3, chart + 3);
}

bool CameraStates::HasMoved(int pose) const {
  double value[7];
  ValueOfVariable(pose, value);
  return !std::equal(value, value + 7, ValueOfPose(problem_, pose));
}

void CameraStates::ValueOf(int pose, double value[7]) const {
  const int frame = pose < problem_.num_images ? problem_.FrameOf(pose) : -1;
  if (frame < 0) {
    ValueOfVariable(pose, value);
    return;
  }
  const int sensor = problem_.SensorOf(pose);
  const int frame_pose = PoseOfFrame(problem_, frame);
  const int sensor_pose = sensor < 0 ? -1 : PoseOfSensor(problem_, sensor);
  if (!HasMoved(frame_pose) && (sensor < 0 || !HasMoved(sensor_pose))) {
    std::copy_n(ValueOfPose(problem_, pose), 7, value);
    return;
  }
  ValueOfVariable(frame_pose, value);
  if (sensor < 0) return;
  double by_sensor[7], turned[4];
  ValueOfVariable(sensor_pose, by_sensor);
  QuaternionProduct(by_sensor, value, turned);
  NormalizeQuaternion(turned);
  std::copy_n(turned, 4, value);
  std::copy_n(poses_[pose].translation, 3, value + 4);
}

void CameraStates::ValueOfVariable(int pose, double value[7]) const {
  double chart[kPoseSize];
  ChartOf(pose, chart);
  std::copy_n((*anchors_)[pose].quaternion, 4, value);
  std::copy_n(chart + 3, 3, value + 4);
  if (chart[0] == 0 && chart[1] == 0 && chart[2] == 0) return;
  double increment[4], rotated[4];
  ExpQuaternion(chart, increment);
  QuaternionProduct(increment, value, rotated);
  NormalizeQuaternion(rotated);
  std::copy_n(rotated, 4, value);
}

std::vector<double> CameraStates::Values(int first, int count) const {
  std::vector<double> values(7 * static_cast<size_t>(count));
  for (int k = 0; k < count; ++k) ValueOf(first + k, &values[7 * static_cast<size_t>(k)]);
  return values;
}

std::vector<double> CameraStates::CamFromWorld() const { return Values(0, problem_.num_images); }

std::vector<double> CameraStates::Twists() const {
  std::vector<double> twists;
  for (const ImageShutter& shutter : shutters_) {
    twists.insert(twists.end(), shutter.twist, shutter.twist + kTwistSize);
  }
  return twists;
}

std::vector<double> CameraStates::RigFromWorld() const {
  return Values(problem_.num_images, problem_.num_frames);
}

std::vector<double> CameraStates::SensorFromRig() const {
  return Values(problem_.num_images + problem_.num_frames, problem_.num_sensors);
}

}  // namespace bundle
