#pragma once

/// Preintegrated IMU samples between two images of a reconstruction in metres: imu_factor.h by
/// poses cam_from_world.
///
/// Variables, in this order: pose of the image i (se3, cam_from_world), its velocity (3), biases of
/// gyroscope (3) and accelerometer (3), pose of the image j, its velocity. With E the constant
/// camera_from_imu, X = cam_from_world and Y = world_from_imu = X^-1 E, a right perturbation of X
/// is one of Y:
///
///   (X Exp(d))^-1 E = Exp(-d) Y = Y Exp(-Ad_{Y^-1} d),        dr/dX = -dr/dY Ad_{E^-1 X}.

#include <memory>
#include <vector>

#include "core/factors/factor.h"
#include "core/factors/imu_factor.h"
#include "core/inertial/preintegration.h"

namespace bundle {

class ImageImuFactor final : public Factor {
 public:
  /// Throws InputError if the motion's covariance is not positive definite, gravity is not three
  /// finite numbers, or `camera_from_imu` is no pose.
  ImageImuFactor(FactorHead head, std::shared_ptr<const Preintegration> motion,
                 std::vector<double> gravity, std::vector<double> camera_from_imu);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  ImuFactor motion_;
  std::vector<double> camera_from_imu_;
};

}  // namespace bundle
