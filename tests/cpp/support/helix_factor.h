#pragma once

/// A factor that leads an image around many turns.

#include <cmath>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "core/factors/factor.h"
#include "core/geometry/rotation.h"
#include "core/model/problem_factors.h"

namespace bundle::testing {

/// The helical valley of R. Fletcher and M. J. D. Powell (A Rapidly Convergent Descent Method for
/// Minimization, 1963) on SE(3). The rotation has to be that of a screw of pitch kTurn at the
/// height t_z, and the translation the target:
///
///   r = (kStiffness (R - Exp(kTurn t_z e_z)), t - target)           [9 + 3],
///
/// so that descent turns the image by kTurn for each unit of height. With right perturbations
/// R Exp(phi), t + R rho:
///
///   dR = R [phi]x,       d Exp(kTurn t_z e_z) = kTurn (R rho)_z [e_z]x Exp(kTurn t_z e_z).
class HelixFactor final : public Factor {
 public:
  static constexpr double kTurn = 2, kStiffness = 3;

  /// Fault of the factor at a height t_z; `jacobian` if derivatives are evaluated as well.
  enum class Fault { kNone, kNoValue, kHigherCost };
  using Faults = std::function<Fault(double height, bool jacobian)>;

  HelixFactor(const std::vector<double>& target, Faults faults)
      : Factor({"helix", {0}, LossType::kTrivial, 1}, {Retraction(Manifold::kSe3, 7)}, 13),
        target_(target),
        faults_(std::move(faults)) {}

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override {
    const double* t = values[0] + 4;
    const Fault fault = faults_ ? faults_(t[2], jacobians != nullptr) : Fault::kNone;
    if (fault == Fault::kNoValue) return false;
    const double axis[3] = {0, 0, 1}, turn[3] = {0, 0, kTurn * t[2]};
    double rotation[9], screw[9], left_jacobian[9], cross[9], screw_by_height[9];
    QuaternionToRotation(values[0], rotation);
    ExpRotation(turn, screw, left_jacobian);
    Skew(axis, cross);
    MatrixProduct3(cross, screw, screw_by_height);
    for (int i = 0; i < 9; ++i) residual[i] = kStiffness * (rotation[i] - screw[i]);
    for (int i = 0; i < 3; ++i) residual[9 + i] = t[i] - target_[i];
    residual[12] = fault == Fault::kHigherCost ? 1e3 : 0;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    for (int j = 0; j < 6; ++j) {
      double unit[3] = {0, 0, 0}, by_rotation[9] = {}, by_translation[3] = {};
      unit[j % 3] = 1;
      if (j < 3) {
        Skew(unit, cross);
        MatrixProduct3(rotation, cross, by_rotation);
      } else {
        MatrixVector3(rotation, unit, by_translation);
        for (int i = 0; i < 9; ++i)
          by_rotation[i] = -kTurn * by_translation[2] * screw_by_height[i];
      }
      for (int i = 0; i < 9; ++i) jacobians[0][6 * i + j] = kStiffness * by_rotation[i];
      for (int i = 0; i < 3; ++i) jacobians[0][6 * (9 + i) + j] = by_translation[i];
      jacobians[0][6 * 12 + j] = 0;
    }
    return true;
  }

 private:
  std::vector<double> target_;
  Faults faults_;
};

/// Such a factor on one image alone.
inline ProblemFactors Helix(int image, const std::vector<double>& target,
                            HelixFactor::Faults faults = nullptr) {
  ProblemFactors result;
  result.variables = {{ProblemVariable::Kind::kImage, image}};
  result.factors.push_back(std::make_unique<HelixFactor>(target, std::move(faults)));
  return result;
}

}  // namespace bundle::testing
