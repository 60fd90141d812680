#include "core/factors/velocity_factor.h"

#include <algorithm>
#include <utility>

#include "core/factors/rolling_shutter.h"
#include "core/geometry/rotation.h"

namespace bundle {

VelocityFactor::VelocityFactor(FactorHead head, std::vector<double> velocity,
                               std::vector<double> lever_arm, std::vector<double> information)
    : Factor(std::move(head),
             {Retraction(Manifold::kSe3, 7), Retraction(Manifold::kEuclidean, kTwistSize),
              Retraction(Manifold::kEuclidean, 1)},
             3),
      velocity_(CheckedValue(name() + ": velocity", Retraction(Manifold::kEuclidean, 3),
                             std::move(velocity))),
      lever_arm_(CheckedValue(name() + ": lever_arm", Retraction(Manifold::kEuclidean, 3),
                              std::move(lever_arm))),
      whitening_(name() + ": information", std::move(information), 3) {}

bool VelocityFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const double *const twist = values[1], rho = values[2][0];
  if (!(rho > 0)) return false;
  double rotation[9], u[3], p[3];
  QuaternionToRotation(values[0], rotation);
  Cross3(twist, lever_arm_.data(), u);
  for (int i = 0; i < 3; ++i) u[i] = -(u[i] + twist[3 + i]) / rho;
  VectorMatrix3(u, rotation, p);
  for (int i = 0; i < 3; ++i) residual[i] = p[i] - velocity_[i];
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    std::fill_n(jacobians[0], 18, 0.0);
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      jacobians[0][6 * i + j] = -p[k];
      jacobians[0][6 * i + k] = p[j];
    }
  }
  if (jacobians != nullptr && jacobians[1] != nullptr) {
    for (int i = 0; i < 3; ++i) {
      double axis[3];  // row i of R^T / rho
      for (int j = 0; j < 3; ++j) axis[j] = rotation[3 * j + i] / rho;
      Cross3(axis, lever_arm_.data(), jacobians[1] + 6 * i);  // a^T [l]x = (a x l)^T
      for (int j = 0; j < 3; ++j) jacobians[1][6 * i + 3 + j] = -axis[j];
    }
  }
  if (jacobians != nullptr && jacobians[2] != nullptr) {
    for (int i = 0; i < 3; ++i) jacobians[2][i] = -p[i] / rho;
  }
  whitening_.Apply(residual, jacobians, {6, kTwistSize, 1});
  return true;
}

}  // namespace bundle
