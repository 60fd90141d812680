#include "core/fused/eliminate/state_records.h"

#include <algorithm>

namespace bundle::fused {
namespace {

/// Room for every model's parameters, in whole quads.
int RoundedParams(const ProblemView& problem) {
  return std::max(4, (std::min(problem.camera_params_stride, kMaxCameraParams) + 3) / 4 * 4);
}

}  // namespace

State::State(const ProblemView& problem, const ParameterLayout& layout, const PointPlan& plan)
    : camera_side(layout.InitialState(problem)),
      held(plan.chunks.size()),
      problem_(problem),
      cameras_(problem, layout),
      stride_(StateRecords::kParams + RoundedParams(problem)) {
  points.reserve(3 * plan.point.size());
  for (const int p : plan.point) {
    points.insert(points.end(), problem.points + 3 * static_cast<int64_t>(p),
                  problem.points + 3 * static_cast<int64_t>(p) + 3);
  }
  images_.resize(static_cast<int64_t>(problem.num_images) * stride_);
  Update();
}

StateRecords State::records() const {
  StateRecords records;
  records.images = images_.data();
  records.stride = stride_;
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
  records.sink = held.Collect(chunk);
  return records;
}

void State::Update() {
  cameras_.Update(camera_side.data());
  for (int i = 0; i < problem_.num_images; ++i) {
    double* const record = images_.data() + static_cast<int64_t>(i) * stride_;
    const PoseState& pose = cameras_.pose(i);
    const int camera = problem_.image_camera[i];
    std::copy_n(pose.rotation, 9, record);
    std::copy_n(pose.translation, 3, record + StateRecords::kTranslation);
    std::copy_n(pose.left_jacobian, 9, record + StateRecords::kLeftJacobian);
    if (problem_.camera_models[camera] == nullptr) continue;  // no image with observations has it
    std::copy_n(cameras_.params(camera), problem_.camera_models[camera]->num_params,
                record + StateRecords::kParams);
  }
}

Step::Step(const ProblemView& problem, const ParameterLayout& layout)
    : problem_(problem),
      layout_(layout),
      poses_(static_cast<int64_t>(problem.num_images) * kPoseSize),
      camera_params_(static_cast<int64_t>(problem.num_cameras) * problem.camera_params_stride),
      stride_(StepRecords::kParams + RoundedParams(problem)) {
  images_.resize(static_cast<int64_t>(problem.num_images) * stride_);
}

void Step::Set(const std::vector<double>& camera_side, const CameraStates& at) {
  layout_.Scatter(problem_, camera_side.data(), poses_.data(), camera_params_.data());
  for (int i = 0; i < problem_.num_images; ++i) {
    double* const record = images_.data() + static_cast<int64_t>(i) * stride_;
    const double* const pose = poses_.data() + static_cast<int64_t>(i) * kPoseSize;
    const int camera = problem_.image_camera[i];
    MatrixVector3(at.pose(i).left_jacobian, pose, record);
    std::copy_n(pose + 3, 3, record + StepRecords::kTranslation);
    if (problem_.camera_models[camera] == nullptr) continue;
    std::copy_n(
        camera_params_.data() + static_cast<int64_t>(camera) * problem_.camera_params_stride,
        problem_.camera_models[camera]->num_params, record + StepRecords::kParams);
  }
}

}  // namespace bundle::fused
