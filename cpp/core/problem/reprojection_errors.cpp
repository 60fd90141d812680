#include "core/problem/reprojection_errors.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

namespace {

/// std::hypot takes several times as long as all other work for an observation's error. It is used
/// only for numbers whose squares would leave the range of doubles.
double Length(const double v[2]) {
  const double squared = v[0] * v[0] + v[1] * v[1];
  return squared > 1e-280 && squared < 1e280 ? std::sqrt(squared) : std::hypot(v[0], v[1]);
}

PoseState PoseAt(const double* cam_from_world, const double* w) {
  double start[9], chart[6];
  QuaternionToRotation(cam_from_world, start);
  std::copy_n(w, 3, chart);
  std::copy_n(cam_from_world + 4, 3, chart + 3);
  PoseState pose;
  ExpandPose(start, chart, &pose);
  return pose;
}

/// The shutter of an image at the problem's own values; false if it is global.
bool FindShutter(const ProblemView& problem, int64_t image, ImageShutter* shutter) {
  const int i = static_cast<int>(image);
  if (!problem.HasRollingShutter(i)) return false;
  std::copy_n(problem.TwistOf(i), kTwistSize, shutter->twist);
  std::copy_n(problem.RowScaleOf(i), 2, shutter->row_scale);
  shutter->at_observed_row = problem.at_observed_row;
  return true;
}

void LinearizeOne(const ProblemView& problem, const PoseState& pose, int64_t i,
                  Cheirality cheirality, const ReprojectionDerivatives& out) {
  const int camera = problem.image_camera[problem.observation_image[i]];
  const CameraModel& model = *problem.camera_models[camera];
  const int stride = problem.camera_params_stride;
  ReprojectionJacobian jacobian;
  ImageShutter shutter;
  const bool rolls = FindShutter(problem, problem.observation_image[i], &shutter);
  EvaluateReprojection(model, pose, problem.ParamsOf(camera),
                       problem.points + 3 * int64_t{problem.observation_point[i]},
                       problem.observation_xy + 2 * i, cheirality, out.residual + 2 * i, &jacobian,
                       rolls ? &shutter : nullptr);
  std::copy_n(jacobian.pose, 12, out.d_pose + 12 * i);
  std::copy_n(jacobian.point, 6, out.d_point + 6 * i);
  if (out.d_twist != nullptr) {
    double* const d_twist = out.d_twist + 2 * kTwistSize * i;
    std::fill_n(d_twist, 2 * kTwistSize, 0.0);
    if (rolls) std::copy_n(jacobian.twist, 2 * kTwistSize, d_twist);
  }
  double* d_params = out.d_params + 2 * stride * i;
  std::fill_n(d_params, 2 * stride, 0.0);
  for (int row = 0; row < 2; ++row) {
    std::copy_n(jacobian.params + model.num_params * row, model.num_params,
                d_params + stride * row);
  }
}

/// Calls visit(observation, residual) for every observation, on all threads. The residual is NaN if
/// the formula has no value.
template <typename Visit>
void ForResiduals(const ProblemView& problem, int num_threads, Cheirality cheirality,
                  uint8_t* behind, const Visit& visit) {
  CheckCameraModelsKnown(problem);
  const Cheirality seen = cheirality == Cheirality::kZero ? cheirality : Cheirality::kAuto;
  std::vector<double> rotations(9 * static_cast<size_t>(problem.num_images));
  for (int64_t i = 0; i < problem.num_images; ++i) {
    QuaternionToRotation(problem.cam_from_world + 7 * i, &rotations[9 * i]);
  }
  ParallelFor(problem.num_observations, num_threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const int64_t image = problem.observation_image[i];
      const int camera = problem.image_camera[image];
      const double* translation = problem.cam_from_world + 7 * image + 4;
      double point[3], xy[2];
      MatrixVector3(&rotations[9 * image],
                    problem.points + 3 * static_cast<int64_t>(problem.observation_point[i]), point);
      for (int j = 0; j < 3; ++j) point[j] += translation[j];
      const CameraModel& model = *problem.camera_models[camera];
      const double* params = problem.ParamsOf(camera);
      const double* const measured = problem.observation_xy + 2 * i;
      constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
      double residual[2] = {kNaN, kNaN};
      Projection projection;
      if (ImageShutter shutter; FindShutter(problem, image, &shutter)) {
        projection = ResidualByRow(model, params, shutter, point, measured, residual);
      } else {
        projection = model.project(params, point, xy, nullptr, nullptr);
        if (projection != Projection::kUndefined) {
          model.difference(params, xy, measured, residual, nullptr);
        }
      }
      behind[i] = !Counts(projection, seen);
      if (projection == Projection::kUndefined) residual[0] = residual[1] = kNaN;
      visit(i, residual);
    }
  });
}

}  // namespace

void CheckCameraModelsKnown(const ProblemView& problem) {
  const auto& models = problem.camera_models;
  if (std::find(models.begin(), models.end(), nullptr) == models.end()) return;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i];
    const int camera = problem.image_camera[image];
    if (problem.camera_models[camera] == nullptr) {
      throw InputError("image " + std::to_string(problem.image_ids[image]) + ": camera " +
                       std::to_string(problem.camera_ids[camera]) + " has the camera model " +
                       problem.camera_model_names[camera] + ", which is not supported");
    }
  }
}

void ComputeReprojectionErrors(const ProblemView& problem, int num_threads, Cheirality cheirality,
                               double* errors, uint8_t* behind) {
  ForResiduals(problem, num_threads, cheirality, behind,
               [=](int64_t i, const double* residual) { errors[i] = Length(residual); });
}

void ComputeReprojectionResiduals(const ProblemView& problem, int num_threads,
                                  Cheirality cheirality, double* residuals, uint8_t* behind) {
  ForResiduals(problem, num_threads, cheirality, behind, [=](int64_t i, const double* residual) {
    std::copy_n(residual, 2, residuals + 2 * i);
  });
}

void Linearize(const ProblemView& problem, const double* rotation_offsets, Cheirality cheirality,
               const ReprojectionDerivatives& out) {
  CheckCameraModelsKnown(problem);
  std::vector<PoseState> poses;
  for (int64_t i = 0; i < problem.num_images; ++i) {
    poses.push_back(PoseAt(problem.cam_from_world + 7 * i, rotation_offsets + 3 * i));
  }
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    LinearizeOne(problem, poses[problem.observation_image[i]], i, cheirality, out);
  }
}

}  // namespace bundle
