#pragma once

/// Test of Jacobians on a sample of observations (derived in spot_check.cpp).

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/reprojection.h"

namespace bundle {

/// An observation and the numbers on which its residual depends: x = (v, t, parameters of the
/// model, point, twist), with v as in factors/reprojection.h. For an image of a rig, (v, t) are
/// local coordinates. Only rolling shutters have a twist.
struct ObservationAtPoint {
  static constexpr int kMaxSize = kPoseSize + kMaxCameraParams + 3 + kTwistSize;
  static_assert(kMaxSize <= 32);

  int64_t observation = 0;
  const CameraModel* model = nullptr;
  bool rolls = false;
  uint32_t free = 0;  ///< bit j: x_j is refined; other columns are not checked
  double x[kMaxSize] = {};

  int first_of_point() const { return kPoseSize + model->num_params; }
  int first_of_twist() const { return first_of_point() + 3; }
  int size() const { return first_of_twist() + (rolls ? kTwistSize : 0); }
};

/// The residual (2) of an observation at x and, unless `jacobian` is nullptr, its claimed
/// derivatives: 2 x size, row-major. Returns false if the observation does not count.
using ClaimedDerivatives =
    std::function<bool(int64_t observation, const double* x, double* residual, double* jacobian)>;

/// Compares the claimed Jacobian columns with differences of the residual. Returns a message with
/// the kind of the wrong column, its error, and a reference to `bundle check`; "" if no column is
/// wrong. Takes about 5 microseconds per observation.
std::string SpotCheck(const std::vector<ObservationAtPoint>& sample,
                      const ClaimedDerivatives& derivatives);

}  // namespace bundle
