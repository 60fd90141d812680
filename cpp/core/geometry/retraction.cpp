#include "core/geometry/retraction.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/error.h"
#include "core/geometry/rigid_motion.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

/// ambient_size 0: any.
struct ManifoldShape {
  const char* name;
  Manifold manifold;
  int ambient_size;
  int tangent_size;
};

constexpr ManifoldShape kShapes[] = {
    {"euclidean", Manifold::kEuclidean, 0, 0},
    {"so2", Manifold::kSo2, 1, 1},
    {"so3", Manifold::kSo3, 4, 3},
    {"se2", Manifold::kSe2, 3, 3},
    {"se3", Manifold::kSe3, 7, 6},
};

const ManifoldShape& ShapeOf(Manifold manifold) { return kShapes[static_cast<int>(manifold)]; }

void Identity(int n, double* out) {
  std::fill(out, out + n * n, 0.0);
  for (int i = 0; i < n; ++i) out[i * n + i] = 1;
}

bool ScaleToUnitNorm(double q[4]) {
  const double largest = std::max({std::abs(q[0]), std::abs(q[1]), std::abs(q[2]), std::abs(q[3])});
  if (!(largest > 0) || !std::isfinite(largest)) return false;
  double squared = 0;
  for (int i = 0; i < 4; ++i) {
    q[i] /= largest;
    squared += q[i] * q[i];
  }
  const double norm = std::sqrt(squared);
  for (int i = 0; i < 4; ++i) q[i] /= norm;
  return std::isfinite(norm);
}

/// J_r(d) = J_l(-d), computed by the function for J_l.
template <int kSize>
void OfNegative(const double* delta, void (*left)(const double*, double*), double* out) {
  double negative[kSize];
  for (int i = 0; i < kSize; ++i) negative[i] = -delta[i];
  left(negative, out);
}

}  // namespace

Retraction::Retraction(Manifold manifold, int ambient_size)
    : manifold_(manifold),
      ambient_size_(ambient_size),
      tangent_size_(manifold == Manifold::kEuclidean ? ambient_size
                                                     : ShapeOf(manifold).tangent_size) {
  const int expected = ShapeOf(manifold).ambient_size;
  if (ambient_size < 1 || (expected > 0 && ambient_size != expected)) {
    throw InputError(std::string("expected ") + (expected > 0 ? std::to_string(expected) : "some") +
                     " numbers for " + name() + ", found " + std::to_string(ambient_size));
  }
}

const char* Retraction::name() const { return ShapeOf(manifold_).name; }

void Retraction::Plus(const double* x, const double* delta, double* out) const {
  double step[7], moved[7];
  switch (manifold_) {
    case Manifold::kEuclidean:
    case Manifold::kSo2:
      for (int i = 0; i < ambient_size_; ++i) out[i] = x[i] + delta[i];
      return;
    case Manifold::kSo3:
      ExpQuaternion(delta, step);
      QuaternionProduct(x, step, moved);
      break;
    case Manifold::kSe2:
      ExpPlanarMotion(delta, step);
      ComposePlanarMotions(x, step, moved);
      break;
    case Manifold::kSe3:
      ExpRigidMotion(delta, step);
      ComposeRigidMotions(x, step, moved);
      break;
  }
  if (manifold_ != Manifold::kSe2) ScaleToUnitNorm(moved);
  std::copy(moved, moved + ambient_size_, out);
}

void Retraction::Between(const double* x, const double* y, double* out) const {
  switch (manifold_) {
    case Manifold::kEuclidean:
    case Manifold::kSo2:
      for (int i = 0; i < ambient_size_; ++i) out[i] = y[i] - x[i];
      return;
    case Manifold::kSo3: {
      const double conjugate[4] = {-x[0], -x[1], -x[2], x[3]};
      return QuaternionProduct(conjugate, y, out);
    }
    case Manifold::kSe2:
      return PlanarMotionBetween(x, y, out);
    case Manifold::kSe3:
      return RigidMotionBetween(x, y, out);
  }
}

void Retraction::Local(const double* x, const double* y, double* delta) const {
  double between[7];
  switch (manifold_) {
    case Manifold::kEuclidean:
      return Between(x, y, delta);
    case Manifold::kSo2:
      *delta = WrapAngle(*y - *x);
      return;
    case Manifold::kSo3:
      Between(x, y, between);
      return LogQuaternion(between, delta);
    case Manifold::kSe2:
      Between(x, y, between);
      return LogPlanarMotion(between, delta);
    case Manifold::kSe3:
      Between(x, y, between);
      return LogRigidMotion(between, delta);
  }
}

void Retraction::Adjoint(const double* x, double* out) const {
  switch (manifold_) {
    case Manifold::kEuclidean:
    case Manifold::kSo2:
      return Identity(tangent_size_, out);
    case Manifold::kSo3:
      return QuaternionToRotation(x, out);
    case Manifold::kSe2:
      return AdjointOfPlanarMotion(x, out);
    case Manifold::kSe3:
      return AdjointOfRigidMotion(x, out);
  }
}

void Retraction::RightJacobian(const double* delta, double* out) const {
  switch (manifold_) {
    case Manifold::kEuclidean:
    case Manifold::kSo2:
      return Identity(tangent_size_, out);
    case Manifold::kSo3:
      return OfNegative<3>(delta, LeftJacobian, out);
    case Manifold::kSe2:
      return RightJacobianOfPlanarMotion(delta, out);
    case Manifold::kSe3:
      return OfNegative<6>(delta, LeftJacobianOfRigidMotion, out);
  }
}

void Retraction::InverseRightJacobian(const double* delta, double* out) const {
  switch (manifold_) {
    case Manifold::kEuclidean:
    case Manifold::kSo2:
      return Identity(tangent_size_, out);
    case Manifold::kSo3:
      return OfNegative<3>(delta, InverseLeftJacobian, out);
    case Manifold::kSe2:
      return InverseRightJacobianOfPlanarMotion(delta, out);
    case Manifold::kSe3:
      return OfNegative<6>(delta, InverseLeftJacobianOfRigidMotion, out);
  }
}

bool Retraction::Normalize(double* x) const {
  const bool has_quaternion = manifold_ == Manifold::kSo3 || manifold_ == Manifold::kSe3;
  return !has_quaternion || ScaleToUnitNorm(x);
}

std::string Retraction::CoordinateName(int coordinate) const {
  const char* const rotation[3] = {"rotation x", "rotation y", "rotation z"};
  const char* const translation[3] = {"translation x", "translation y", "translation z"};
  const char* const planar[3] = {"x", "y", "angle"};
  switch (manifold_) {
    case Manifold::kEuclidean:
      return "[" + std::to_string(coordinate) + "]";
    case Manifold::kSo2:
      return "angle";
    case Manifold::kSe2:
      return planar[coordinate];
    case Manifold::kSo3:
    case Manifold::kSe3:
      break;
  }
  return coordinate < 3 ? rotation[coordinate] : translation[coordinate - 3];
}

Retraction RetractionFromName(const std::string& name, int ambient_size) {
  for (const ManifoldShape& shape : kShapes) {
    if (name == shape.name) return Retraction(shape.manifold, ambient_size);
  }
  throw InputError("manifold: expected one of euclidean, so2, so3, se2, se3, found " + name);
}

}  // namespace bundle
