#pragma once

/// Preintegrated IMU samples between two states as a factor: W r of inertial/imu_residual.h.
///
/// Variables, in this order: pose of the IMU i (se3, world_from_imu), velocity i (3), biases i (6:
/// gyroscope, accelerometer), pose j, velocity j, and optionally gravity and the scale of the
/// positions. The tangent of a pose moves its position by R v, so that the columns of v are those
/// of the position times R.
///
/// Gravity is a vector (euclidean, 3), or a rotation Q (so3) of the constant g0: g = Q g0, with dg
/// = -Q [g0]x d. A rotation about g0 itself has no effect. With a scale s (euclidean, 1), positions
/// are s p in metres, for camera trajectories without a unit of length:
///
///   dr/dp <- s dr/dp,        dr/ds = dr/dp p + dr/dp' p'.

#include <memory>
#include <vector>

#include "core/factors/factor.h"
#include "core/inertial/preintegration.h"

namespace bundle {

class ImuFactor final : public Factor {
 public:
  /// `variable` is the manifold of a gravity variable, or nullptr. `gravity` is constant without
  /// such a variable, and rotated by a variable on so3. Throws InputError if the motion's
  /// covariance is not positive definite, or gravity is not three finite numbers.
  ImuFactor(FactorHead head, std::shared_ptr<const Preintegration> motion,
            std::vector<double> gravity, const Retraction* variable, bool has_scale);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::shared_ptr<const Preintegration> motion_;
  std::vector<double> gravity_;
  bool has_gravity_;
  bool has_scale_;
};

}  // namespace bundle
