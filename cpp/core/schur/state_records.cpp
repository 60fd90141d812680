#include "core/schur/state_records.h"

#include <algorithm>
#include <limits>

#include "core/schur/elimination_plan.h"

namespace bundle {

namespace {

/// Space for the parameters of every model, in whole quads.
int RoundedParams(const AdjustmentProblem& problem) {
  return std::max(4, (std::min(problem.camera_params_stride, kMaxCameraParams) + 3) / 4 * 4);
}

// Sizes in a record, in whole quads.
constexpr int kTranslationJacobian = 12, kSensorMap = kPoseSize * kPoseSize;

bool RefinesSensors(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  for (int i = 0; i < problem.num_images; ++i) {
    if (layout.blocks_of(i)[ParameterLayout::kSensorBlock] >= 0) return true;
  }
  return false;
}

int ShutterSize(const AdjustmentProblem& problem) {
  return problem.row_scale.empty() ? 0 : kShutter;
}

int RecordStride(const AdjustmentProblem& problem, bool has_sensor_maps) {
  return StateRecords::kParams + RoundedParams(problem) +
         (problem.num_frames > 0 ? kTranslationJacobian : 0) + (has_sensor_maps ? kSensorMap : 0) +
         ShutterSize(problem);
}

}  // namespace

State::State(const AdjustmentProblem& problem, const ParameterLayout& layout,
             const EliminationPlan& plan)
    : points(3 * plan.point.size()),
      held(plan.chunks.size()),
      problem_(problem),
      has_sensor_maps_(RefinesSensors(problem, layout)),
      cameras_(problem, layout),
      stride_(RecordStride(problem, has_sensor_maps_)) {
  images_.resize(static_cast<int64_t>(problem.num_images) * stride_);
  if (!problem.row_scale.empty()) row_times_.resize(plan.num_observations());
  Reset(layout, plan);
}

void State::Reset(const ParameterLayout& layout, const EliminationPlan& plan) {
  camera_state = layout.InitialState(problem_);
  for (size_t k = 0; k < plan.point.size(); ++k) {
    std::copy_n(problem_.points + 3 * int64_t{plan.point[k]}, 3, &points[3 * k]);
  }
  held.Clear();
  cameras_.Reset();
  Update();
  ForgetRowTimes();
}

void State::ForgetRowTimes() {
  std::fill(row_times_.begin(), row_times_.end(), std::numeric_limits<double>::quiet_NaN());
}

StateRecords State::records() const {
  StateRecords records;
  records.images = images_.data();
  records.stride = stride_;
  const int end = stride_ - ShutterSize(problem_);
  if (end < stride_) records.shutter = end;
  records.at_observed_row = problem_.at_observed_row;
  records.row_times = row_times_.data();
  if (has_sensor_maps_) records.sensor_map = end - kSensorMap;
  if (problem_.num_frames > 0) {
    records.translation_jacobian = end - kTranslationJacobian - (has_sensor_maps_ ? kSensorMap : 0);
  }
  records.points = points.data();
  records.held = held.all().data();
  records.num_held = static_cast<int64_t>(held.all().size());
  return records;
}

StateRecords State::CandidateRecords(const StateRecords& before, int chunk) {
  StateRecords records = before;
  records.before = &before;
  records.images = images_.data();
  records.points = points.data();
  if (!row_times_.empty()) records.found_row_times = row_times_.data();
  records.sink = held.Collect(chunk);
  return records;
}

void State::Update() {
  cameras_.Update(camera_state.data());
  for (int i = 0; i < problem_.num_images; ++i) {
    double* const record = images_.data() + static_cast<int64_t>(i) * stride_;
    const PoseState& pose = cameras_.pose(i);
    const int camera = problem_.image_camera[i];
    std::copy_n(pose.rotation, 9, record);
    std::copy_n(pose.translation, 3, record + StateRecords::kTranslation);
    std::copy_n(pose.left_jacobian, 9, record + StateRecords::kLeftJacobian);
    if (problem_.num_frames > 0) PutFrameChart(cameras_.rig(i), record);
    if (const ImageShutter* const shutter = cameras_.shutter(i)) {
      double* const to = std::copy_n(shutter->twist, kTwistSize, record + stride_ - kShutter);
      std::copy_n(shutter->row_scale, 2, to);
    }
    if (problem_.camera_models[camera] == nullptr) continue;  // camera without observations
    std::copy_n(cameras_.params(camera), problem_.camera_models[camera]->num_params,
                record + StateRecords::kParams);
  }
}

/// Derivatives w.r.t. the chart of the frame: R_s J_f and R_s. Without a rig, the translation is a
/// coordinate itself. Also K of the sensor.
void State::PutFrameChart(const RigPose& rig, double* record) const {
  const int end = stride_ - ShutterSize(problem_);
  double* translation = record + end - kTranslationJacobian;
  if (has_sensor_maps_) {
    double* const map = record + end - kSensorMap;
    translation -= kSensorMap;
    if (rig.sensor != nullptr) SensorByFrameMap(rig, map);
  }
  const bool turned = rig.frame != nullptr && rig.sensor != nullptr;
  std::copy_n(turned ? rig.sensor->rotation : kIdentity3, 9, translation);
  if (rig.frame == nullptr) return;
  MatrixProduct3(translation, rig.frame->left_jacobian, record + StateRecords::kLeftJacobian);
}

void State::MoveAnchors() {
  if (!cameras_.MoveAnchors()) return;
  Update();
  ForgetRowTimes();  // the last bits of poses changed
}

LargeVector<double> State::AllPoints(const EliminationPlan& plan) const {
  LargeVector<double> all(problem_.points,
                          problem_.points + 3 * static_cast<int64_t>(problem_.num_points));
  for (int p = 0; p < plan.num_free_points; ++p) {
    std::copy_n(&points[3 * int64_t{p}], 3, &all[3 * int64_t{plan.point[p]}]);
  }
  return all;
}

DoubleDouble State::FreePointsSquared(const EliminationPlan& plan) const {
  DoubleDouble sum;
  for (int64_t i = 0; i < 3 * int64_t{plan.num_free_points}; ++i) sum.Add(points[i] * points[i]);
  return sum;
}

CameraStep::CameraStep(const AdjustmentProblem& problem, const ParameterLayout& layout)
    : problem_(problem),
      layout_(layout),
      poses_(static_cast<int64_t>(NumPoses(problem)) * kPoseSize),
      camera_params_(static_cast<int64_t>(problem.num_cameras) * problem.camera_params_stride),
      twists_(problem.row_scale.empty() ? 0 : size_t{kTwistSize} * problem.num_images),
      readouts_(problem.num_cameras),
      stride_(StepRecords::kParams + RoundedParams(problem) + ShutterSize(problem)) {
  images_.resize(static_cast<int64_t>(problem.num_images) * stride_);
}

void CameraStep::Set(const std::vector<double>& camera_state, const CameraStates& at) {
  layout_.Scatter(problem_, camera_state.data(), poses_.data(), camera_params_.data(),
                  twists_.data(), readouts_.data());
  for (int i = 0; i < problem_.num_images; ++i) {
    double* const record = images_.data() + static_cast<int64_t>(i) * stride_;
    const double* const pose = PoseStep(i);
    const int camera = problem_.image_camera[i];
    if (problem_.FrameOf(i) >= 0) {
      SetOnRig(i, at.rig(i), record);
    } else {
      MatrixVector3(at.pose(i).left_jacobian, pose, record);
      std::copy_n(pose + 3, 3, record + StepRecords::kTranslation);
      if (TurnsAboutCentre(problem_, i)) {
        Cross3(record, at.pose(i).translation, record + StepRecords::kTranslation);
      }
    }
    if (const TwistMap* const map = at.twist_map(i)) {
      SetHardTwist(i, *map, record + stride_ - kShutter);
    } else if (problem_.HasRollingShutter(i)) {
      std::copy_n(&twists_[size_t{kTwistSize} * i], kTwistSize, record + stride_ - kShutter);
    }
    if (problem_.camera_models[camera] == nullptr) continue;
    std::copy_n(
        camera_params_.data() + static_cast<int64_t>(camera) * problem_.camera_params_stride,
        problem_.camera_models[camera]->num_params, record + StepRecords::kParams);
  }
}

void CameraStep::SetHardTwist(int image, const TwistMap& map, double* step) const {
  const double* const before = PoseStep(problem_.twist_neighbours[2 * int64_t{image}]);
  const double* const after = PoseStep(problem_.twist_neighbours[2 * int64_t{image} + 1]);
  for (int i = 0; i < kTwistSize; ++i) {
    step[i] = map.readout[i] * readouts_[problem_.image_camera[image]];
    for (int j = 0; j < kPoseSize; ++j) {
      step[i] +=
          map.before[kPoseSize * i + j] * before[j] + map.after[kPoseSize * i + j] * after[j];
    }
  }
}

/// (phi, tau) = M_f d_f + M_s d_s (factors/rig_pose.h).
void CameraStep::SetOnRig(int image, const RigPose& rig, double* record) const {
  double map[36];
  const auto add = [&](const double* step) {
    for (int i = 0; i < kPoseSize; ++i) {
      for (int j = 0; j < kPoseSize; ++j) record[i] += map[kPoseSize * i + j] * step[j];
    }
  };
  std::fill_n(record, kPoseSize, 0.0);
  FrameMap(rig, map);
  add(PoseStep(PoseOfFrame(problem_, problem_.FrameOf(image))));
  if (rig.sensor == nullptr) return;
  SensorMap(rig, map);
  add(PoseStep(PoseOfSensor(problem_, problem_.SensorOf(image))));
}

}  // namespace bundle
