#pragma once

#include <vector>

#include "core/problem/problem_view.h"
#include "core/residuals/reprojection.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// The camera side of a problem at one state, expanded once an evaluation so that an observation
/// only reads: rotation, translation and left Jacobian of each image, parameters of each camera.
class CameraStates {
 public:
  /// Keeps references to both; starts at the problem's own values.
  CameraStates(const ProblemView& problem, const ParameterLayout& layout);

  void Update(const double* state);

  /// R0 and (w, t) of an image (residuals/reprojection.h).
  const double* start_rotation(int image) const {
    return start_rotations_.data() + 9 * static_cast<int64_t>(image);
  }
  const double* chart(int image) const {
    return charts_.data() + kPoseSize * static_cast<int64_t>(image);
  }
  const PoseState& pose(int image) const { return poses_[image]; }
  const double* params(int camera) const {
    return camera_params_.data() + static_cast<int64_t>(camera) * stride_;
  }

  /// The refined poses as quaternion and translation (num_images x 7): Exp(w) q0. A pose that did
  /// not move keeps every bit of what it was.
  std::vector<double> CamFromWorld() const;
  const std::vector<double>& camera_params() const { return camera_params_; }

 private:
  const ProblemView& problem_;
  const ParameterLayout& layout_;
  const int stride_;
  std::vector<double> charts_;           ///< (w, t) of each image
  std::vector<double> start_rotations_;  ///< R0 of each image
  std::vector<PoseState> poses_;
  std::vector<double> camera_params_;
};

}  // namespace bundle
