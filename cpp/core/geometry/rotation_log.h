#pragma once

/// Logarithms of rotations and the inverse of the left Jacobian (rotation.h).
///
/// A unit quaternion (v, s) = (sin(a/2) u, cos(a/2)) is the rotation Exp(a u). q and -q are the
/// same rotation; the one with s >= 0 has a in [0, pi]:
///
///   Log(q) = 2 atan2(|v|, s) / |v| v,
///
/// which keeps its digits at every angle, unlike the logarithm by the trace of the matrix: close to
/// a = pi the trace is flat. Rotations of pi have two logarithms; either may be returned.
///
/// The inverse of J_l(w) = I + B W + C W^2 is
///
///   J_l(w)^-1 = I - 1/2 W + D W^2,       D = (1 - (a/2) cot(a/2)) / a^2
///
/// (Sola et al. 2018, eq. 146), regular for a < 2 pi. D = sum |B_2n| a^(2n-2) / (2n)! with
/// Bernoulli's numbers; seven terms serve below a^2 = 1/4, where the formula begins to lose digits.

#include <cmath>

#include "core/geometry/rotation.h"

namespace bundle {

/// An angle in [-pi, pi] that differs from the given one by whole turns.
inline double WrapAngle(double angle) { return std::remainder(angle, 2 * M_PI); }

/// The rotation vector of a quaternion (x y z w) of any nonzero norm, of an angle of at most pi.
inline void LogQuaternion(const double q[4], double w[3]) {
  const double sine = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
  const double cosine = std::abs(q[3]);
  // atan2(y, x) / y ~ 1 / x where y vanishes beside x; the next term is of the order of y^2.
  const double factor = sine < 1e-9 * cosine ? 2 / cosine : 2 * std::atan2(sine, cosine) / sine;
  const double sign = q[3] < 0 ? -1 : 1;
  for (int i = 0; i < 3; ++i) w[i] = sign * factor * q[i];
}

/// D of the derivation above, as a function of the squared angle, which is below (2 pi)^2.
inline double LogCoefficient(double angle_squared) {
  const double s = angle_squared;
  if (s < 0.25) {
    return 1.0 / 12 +
           s * (1.0 / 720 +
                s * (1.0 / 30240 +
                     s * (1.0 / 1209600 + s * (1.0 / 47900160 + s * (691.0 / 1307674368000.0 +
                                                                     s * (1.0 / 74724249600.0))))));
  }
  const double half = 0.5 * std::sqrt(s);
  return (1 - half * std::cos(half) / std::sin(half)) / s;
}

/// J_l(w)^-1
inline void InverseLeftJacobian(const double w[3], double out[9]) {
  SkewPolynomial(w, -0.5, LogCoefficient(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), out);
}

/// J_l(w)
inline void LeftJacobian(const double w[3], double out[9]) {
  const RotationCoefficients k = ExpCoefficients(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  SkewPolynomial(w, k.b, k.c, out);
}

}  // namespace bundle
