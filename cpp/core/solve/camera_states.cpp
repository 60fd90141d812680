#include "core/solve/camera_states.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/geometry/rotation.h"

namespace bundle {

CameraStates::CameraStates(const ProblemView& problem, const ParameterLayout& layout)
    : problem_(problem),
      layout_(layout),
      stride_(problem.camera_params_stride),
      charts_(static_cast<size_t>(problem.num_images) * kPoseSize),
      start_rotations_(static_cast<size_t>(problem.num_images) * 9),
      poses_(problem.num_images),
      camera_params_(
          problem.camera_params,
          problem.camera_params + static_cast<std::ptrdiff_t>(problem.num_cameras) * stride_) {
  for (int64_t i = 0; i < problem.num_images; ++i) {
    const double* pose = problem.cam_from_world + 7 * i;
    QuaternionToRotation(pose, &start_rotations_[9 * i]);
    std::copy(pose + 4, pose + 7, &charts_[kPoseSize * i + 3]);
  }
  Update(layout.InitialState(problem).data());
}

void CameraStates::Update(const double* state) {
  layout_.Scatter(problem_, state, charts_.data(), camera_params_.data());
  for (size_t i = 0; i < poses_.size(); ++i) {
    ExpandPose(&start_rotations_[9 * i], &charts_[kPoseSize * i], &poses_[i]);
  }
}

std::vector<double> CameraStates::CamFromWorld() const {
  std::vector<double> cam_from_world(problem_.cam_from_world,
                                     problem_.cam_from_world + 7 * poses_.size());
  for (size_t i = 0; i < poses_.size(); ++i) {
    const double* w = &charts_[kPoseSize * i];
    double* pose = &cam_from_world[7 * i];
    std::copy(w + 3, w + 6, pose + 4);
    if (w[0] == 0 && w[1] == 0 && w[2] == 0) continue;
    double increment[4], rotated[4];
    ExpQuaternion(w, increment);
    QuaternionProduct(increment, pose, rotated);
    const double norm =
        std::hypot(std::hypot(rotated[0], rotated[1]), std::hypot(rotated[2], rotated[3]));
    for (int j = 0; j < 4; ++j) pose[j] = rotated[j] / norm;
  }
  return cam_from_world;
}

}  // namespace bundle
