#include "core/factors/attitude_factors.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "core/geometry/rotation.h"

namespace bundle {
namespace {

constexpr int kPoseTangent = 6;

std::vector<Retraction> OfPose() { return {Retraction(Manifold::kSe3, 7)}; }

/// Returns a vector scaled to length 1.
std::vector<double> CheckedDirection(const std::string& subject, std::vector<double> vector) {
  vector = CheckedValue(subject, Retraction(Manifold::kEuclidean, 3), std::move(vector));
  const double most = std::max({std::abs(vector[0]), std::abs(vector[1]), std::abs(vector[2])});
  if (!(most > 0)) throw InputError(subject + ": expected a vector other than zero, found 0 0 0");
  for (double& v : vector) v /= most;
  const double norm = std::hypot(vector[0], vector[1], vector[2]);
  for (double& v : vector) v /= norm;
  return vector;
}

double CheckedSigma(const std::string& name, double sigma) {
  if (!(sigma > 0) || !std::isfinite(sigma)) {
    throw InputError(name + ": sigma: expected a finite number above 0, found " +
                     ShortNumber(sigma));
  }
  return sigma;
}

/// Writes rows w.r.t. a rotation into rows w.r.t. a pose, whose translation has no effect.
void WriteRows(int rows, const double* by_rotation, double* jacobian) {
  std::fill_n(jacobian, rows * kPoseTangent, 0.0);
  for (int r = 0; r < rows; ++r) {
    std::copy_n(by_rotation + 3 * r, 3, jacobian + kPoseTangent * r);
  }
}

}  // namespace

DirectionFactor::DirectionFactor(FactorHead head, std::vector<double> direction,
                                 std::vector<double> axis, double sigma)
    : Factor(std::move(head), OfPose(), 3),
      direction_(CheckedDirection(name() + ": direction", std::move(direction))),
      axis_(CheckedDirection(name() + ": axis", std::move(axis))),
      sigma_(CheckedSigma(name(), sigma)) {}

bool DirectionFactor::Evaluate(const double* const* values, double* residual,
                               double* const* jacobians) const {
  double rotation[9], p[3];
  QuaternionToRotation(values[0], rotation);
  MatrixVector3(rotation, axis_.data(), p);
  for (int i = 0; i < 3; ++i) residual[i] = (p[i] - direction_[i]) / sigma_;
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    double minus_cross[9], by_rotation[9];
    for (double& coordinate : p) coordinate /= -sigma_;
    Skew(p, minus_cross);
    MatrixProduct3(minus_cross, rotation, by_rotation);
    WriteRows(3, by_rotation, jacobians[0]);
  }
  return true;
}

RotationFactor::RotationFactor(FactorHead head, std::vector<double> rotation,
                               std::vector<double> information)
    : Factor(std::move(head), OfPose(), 3),
      rotation_(
          CheckedValue(name() + ": rotation", Retraction(Manifold::kSo3, 4), std::move(rotation))),
      whitening_(name() + ": information", std::move(information), 3) {}

bool RotationFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const Retraction retraction(Manifold::kSo3, 4);
  retraction.Local(rotation_.data(), values[0], residual);
  double inverse[9];
  const bool wanted = jacobians != nullptr && jacobians[0] != nullptr;
  if (wanted) {
    retraction.InverseRightJacobian(residual, inverse);
    whitening_.Apply(inverse, 3);
    WriteRows(3, inverse, jacobians[0]);
  }
  whitening_.Apply(residual, 1);
  return true;
}

HeadingFactor::HeadingFactor(FactorHead head, std::vector<double> axis, double heading,
                             double sigma)
    : Factor(std::move(head), OfPose(), 1),
      axis_(CheckedDirection(name() + ": axis", std::move(axis))),
      heading_(heading),
      sigma_(CheckedSigma(name(), sigma)) {
  if (!std::isfinite(heading)) {
    throw InputError(name() + ": heading: expected a finite number, found " + ShortNumber(heading));
  }
}

bool HeadingFactor::Evaluate(const double* const* values, double* residual,
                             double* const* jacobians) const {
  double rotation[9], y[3];
  QuaternionToRotation(values[0], rotation);
  VectorMatrix3(axis_.data(), rotation, y);
  const double squared = y[0] * y[0] + y[1] * y[1];
  if (!(squared > 0)) return false;
  residual[0] = WrapAngle(std::atan2(y[0], y[1]) - heading_) / sigma_;
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    const double by_rotation[3] = {-y[2] * y[0] / squared / sigma_, -y[2] * y[1] / squared / sigma_,
                                   1 / sigma_};
    WriteRows(1, by_rotation, jacobians[0]);
  }
  return true;
}

}  // namespace bundle
