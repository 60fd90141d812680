#include "core/factors/position_factor.h"

#include <algorithm>
#include <utility>

#include "core/factors/checked_value.h"
#include "core/geometry/rotation.h"

namespace bundle {

PositionFactor::PositionFactor(FactorHead head, std::vector<double> position,
                               std::vector<double> lever_arm, std::vector<double> information)
    : Factor(std::move(head), {Retraction(Manifold::kSe3, 7)}, 3),
      position_(CheckedValue(name() + ": position", Retraction(Manifold::kEuclidean, 3),
                             std::move(position))),
      lever_arm_(CheckedValue(name() + ": lever_arm", Retraction(Manifold::kEuclidean, 3),
                              std::move(lever_arm))),
      whitening_(name() + ": information", std::move(information), 3) {}

bool PositionFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const double* pose = values[0];
  double rotation[9], antenna[3];
  QuaternionToRotation(pose, rotation);
  const double arm[3] = {lever_arm_[0] - pose[4], lever_arm_[1] - pose[5], lever_arm_[2] - pose[6]};
  VectorMatrix3(arm, rotation, antenna);
  for (int i = 0; i < 3; ++i) residual[i] = antenna[i] - position_[i];
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    const double* y = antenna;
    const double jacobian[18] = {0, -y[2], y[1], -1,    0,    0, y[2], 0, -y[0],
                                 0, -1,    0,    -y[1], y[0], 0, 0,    0, -1};
    std::copy(jacobian, jacobian + 18, jacobians[0]);
  }
  whitening_.Apply(residual, jacobians, {6});
  return true;
}

}  // namespace bundle
