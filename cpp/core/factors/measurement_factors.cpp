#include "core/factors/measurement_factors.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "core/factors/factor.h"
#include "core/factors/reprojection.h"
#include "core/geometry/rotation.h"

namespace bundle {

PriorFactor::PriorFactor(FactorHead head, const Retraction& retraction, std::vector<double> value,
                         std::vector<double> information)
    : Factor(std::move(head), {retraction}, retraction.tangent_size()),
      value_(CheckedValue(name() + ": value", retraction, std::move(value))),
      whitening_(name() + ": information", std::move(information), retraction.tangent_size()) {}

bool PriorFactor::Evaluate(const double* const* values, double* residual,
                           double* const* jacobians) const {
  const Retraction& retraction = retractions()[0];
  retraction.Local(value_.data(), values[0], residual);
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    retraction.InverseRightJacobian(residual, jacobians[0]);
  }
  whitening_.Apply(residual, jacobians, {retraction.tangent_size()});
  return true;
}

ScalarPriorFactor::ScalarPriorFactor(FactorHead head, const Retraction& retraction, int index,
                                     double value, double sigma, bool relative)
    : Factor(std::move(head), {retraction}, 1),
      index_(index),
      value_(value),
      sigma_(sigma),
      relative_(relative) {
  if (retraction.manifold() != Manifold::kEuclidean) {
    throw InputError(name() + ": expected a Euclidean variable, found " + retraction.name());
  }
  if (index < 0 || index >= retraction.tangent_size()) {
    throw InputError(name() + ": index: expected one of 0 to " +
                     std::to_string(retraction.tangent_size() - 1) + ", found " +
                     std::to_string(index));
  }
  if (!std::isfinite(value) || (relative && value == 0)) {
    throw InputError(name() + ": value: expected a finite number" +
                     (relative ? " other than 0" : "") + ", found " + ShortNumber(value));
  }
  if (!(sigma > 0) || !std::isfinite(sigma)) {
    throw InputError(name() + ": sigma: expected a finite number above 0, found " +
                     ShortNumber(sigma));
  }
}

bool ScalarPriorFactor::Evaluate(const double* const* values, double* residual,
                                 double* const* jacobians) const {
  const double x = values[0][index_], error = x - value_;
  if (relative_ && !(error / value_ > -1)) return false;
  residual[0] = (relative_ ? std::log1p(error / value_) : error) / sigma_;
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    std::fill_n(jacobians[0], retractions()[0].tangent_size(), 0.0);
    jacobians[0][index_] = 1 / (relative_ ? sigma_ * x : sigma_);
  }
  return true;
}

PositionFactor::PositionFactor(FactorHead head, std::vector<double> position,
                               std::vector<double> lever_arm, std::vector<double> information,
                               std::vector<double> axes)
    : Factor(head, std::vector<Retraction>(head.blocks.size(), Retraction(Manifold::kSe3, 7)), 3),
      position_(CheckedValue(name() + ": position", Retraction(Manifold::kEuclidean, 3),
                             std::move(position))),
      lever_arm_(CheckedValue(name() + ": lever_arm", Retraction(Manifold::kEuclidean, 3),
                              std::move(lever_arm))),
      axes_(CheckedValue(name() + ": axes", Retraction(Manifold::kEuclidean, 3), std::move(axes))),
      whitening_(name() + ": information", std::move(information), 3) {}

bool PositionFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const double* pose = values[0];
  const bool has_offset = retractions().size() > 1;
  double rotation[9], antenna[3];
  QuaternionToRotation(pose, rotation);
  const double arm[3] = {lever_arm_[0] - pose[4], lever_arm_[1] - pose[5], lever_arm_[2] - pose[6]};
  VectorMatrix3(arm, rotation, antenna);
  for (int i = 0; i < 3; ++i) {
    residual[i] = antenna[i] - position_[i] + (has_offset ? axes_[i] * values[1][4 + i] : 0);
  }
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    const double* y = antenna;
    const double jacobian[18] = {0, -y[2], y[1], -1,    0,    0, y[2], 0, -y[0],
                                 0, -1,    0,    -y[1], y[0], 0, 0,    0, -1};
    std::copy(jacobian, jacobian + 18, jacobians[0]);
  }
  if (!has_offset) {
    whitening_.Apply(residual, jacobians, {6});
    return true;
  }
  if (jacobians != nullptr && jacobians[1] != nullptr) {
    QuaternionToRotation(values[1], rotation);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        jacobians[1][6 * i + j] = 0;
        jacobians[1][6 * i + 3 + j] = axes_[i] * rotation[3 * i + j];
      }
    }
  }
  whitening_.Apply(residual, jacobians, {6, 6});
  return true;
}

namespace {

/// out = J_r(e)^-1 Ad_X, an n x n matrix with n the tangent size. `inverse` is J_r(e)^-1.
void TimesAdjoint(const Retraction& retraction, const double* inverse, const double* x,
                  double* out) {
  const int n = retraction.tangent_size();
  std::vector<double> adjoint(n * n);
  retraction.Adjoint(x, adjoint.data());
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < n; ++c) {
      double sum = 0;
      for (int k = 0; k < n; ++k) sum += inverse[r * n + k] * adjoint[k * n + c];
      out[r * n + c] = sum;
    }
  }
}

void Negate(int count, double* numbers) {
  for (int i = 0; i < count; ++i) numbers[i] = -numbers[i];
}

}  // namespace

BetweenFactor::BetweenFactor(FactorHead head, const Retraction& retraction,
                             std::vector<double> measurement, std::vector<double> information)
    : Factor(std::move(head), {retraction, retraction}, retraction.tangent_size()),
      measurement_(CheckedValue(name() + ": measurement", retraction, std::move(measurement))),
      whitening_(name() + ": information", std::move(information), retraction.tangent_size()) {}

bool BetweenFactor::Evaluate(const double* const* values, double* residual,
                             double* const* jacobians) const {
  const Retraction& retraction = retractions()[0];
  const int n = retraction.tangent_size();
  std::vector<double> between(retraction.ambient_size());
  retraction.Between(values[0], values[1], between.data());
  retraction.Local(measurement_.data(), between.data(), residual);
  if (jacobians == nullptr) {
    whitening_.Apply(residual, 1);
    return true;
  }
  std::vector<double> inverse(n * n);
  retraction.InverseRightJacobian(residual, inverse.data());
  if (jacobians[0] != nullptr) {
    retraction.Between(values[1], values[0], between.data());
    TimesAdjoint(retraction, inverse.data(), between.data(), jacobians[0]);
    Negate(n * n, jacobians[0]);
  }
  if (jacobians[1] != nullptr) std::copy(inverse.begin(), inverse.end(), jacobians[1]);
  whitening_.Apply(residual, jacobians, {n, n});
  return true;
}

RelativePoseFactor::RelativePoseFactor(FactorHead head, std::vector<double> measurement,
                                       std::vector<double> information)
    : Factor(std::move(head), {Retraction(Manifold::kSe3, 7), Retraction(Manifold::kSe3, 7)}, 6),
      measurement_(
          CheckedValue(name() + ": measurement", retractions()[0], std::move(measurement))),
      whitening_(name() + ": information", std::move(information), 6) {}

bool RelativePoseFactor::Evaluate(const double* const* values, double* residual,
                                  double* const* jacobians) const {
  constexpr int kSize = 6;
  constexpr double kIdentity[7] = {0, 0, 0, 1, 0, 0, 0};
  const Retraction& pose = retractions()[0];
  double inverse[2][7], relative[7];
  for (int k = 0; k < 2; ++k) pose.Between(values[k], kIdentity, inverse[k]);
  pose.Between(inverse[1], inverse[0], relative);
  pose.Local(measurement_.data(), relative, residual);
  if (jacobians != nullptr) {
    double inverse_jacobian[kSize * kSize];
    pose.InverseRightJacobian(residual, inverse_jacobian);
    for (int k = 0; k < 2; ++k) {
      if (jacobians[k] != nullptr) {
        TimesAdjoint(pose, inverse_jacobian, values[0], jacobians[k]);
      }
    }
    if (jacobians[0] != nullptr) Negate(kSize * kSize, jacobians[0]);
  }
  whitening_.Apply(residual, jacobians, {kSize, kSize});
  return true;
}

namespace {

PoseState StateOf(const double* pose) {
  PoseState state = {};
  QuaternionToRotation(pose, state.rotation);
  std::copy(pose + 4, pose + 7, state.translation);
  for (int i = 0; i < 3; ++i) state.left_jacobian[4 * i] = 1;
  return state;
}

}  // namespace

ReprojectionFactor::ReprojectionFactor(FactorHead head, const CameraModel& model,
                                       std::vector<double> observation,
                                       std::vector<double> information)
    : Factor(std::move(head),
             {Retraction(Manifold::kSe3, 7), Retraction(Manifold::kEuclidean, model.num_params),
              Retraction(Manifold::kEuclidean, 3)},
             2),
      model_(model),
      observation_(CheckedValue(name() + ": observation", Retraction(Manifold::kEuclidean, 2),
                                std::move(observation))),
      whitening_(name() + ": information", std::move(information), 2) {}

bool ReprojectionFactor::Evaluate(const double* const* values, double* residual,
                                  double* const* jacobians) const {
  const PoseState state = StateOf(values[0]);
  ReprojectionJacobian jacobian;
  if (!EvaluateReprojection(model_, state, values[1], values[2], observation_.data(),
                            Cheirality::kAlgebraic, residual,
                            jacobians == nullptr ? nullptr : &jacobian)) {
    return false;
  }
  if (jacobians != nullptr) {
    if (jacobians[0] != nullptr) {
      for (int part = 0; part < 4; ++part) {  // of two rows: rotation, translation
        VectorMatrix3(jacobian.pose + 3 * part, state.rotation, jacobians[0] + 3 * part);
      }
    }
    if (jacobians[1] != nullptr) {
      std::copy_n(jacobian.params, 2 * model_.num_params, jacobians[1]);
    }
    if (jacobians[2] != nullptr) std::copy_n(jacobian.point, 6, jacobians[2]);
  }
  whitening_.Apply(residual, jacobians, {6, model_.num_params, 3});
  return true;
}

}  // namespace bundle
