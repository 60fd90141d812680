#pragma once

/// SE(2): rigid motions of the plane, their exponential map, logarithm, adjoint and right Jacobian.
///
/// A motion is stored as x y angle (units of length, radians), a tangent vector d = (u, v, a) in
/// the same order. With sin a / a =: A and (1 - cos a)/a =: aB (B and C as in rotation.h)
///
///   Exp(d) = (M(a) (u, v), a),      M(a) = [ A  -aB ]      M(a)^-1 = [ 1 - a^2 D    a/2     ]
///                                          [ aB   A ],              [ -a/2      1 - a^2 D  ],
///
/// where D is that of rotation_log.h: (a/2) cot(a/2) = 1 - a^2 D. The adjoint,
/// X Exp(d) X^-1 = Exp(Ad_X d), and the right Jacobian, Exp(d + e) = Exp(d) Exp(J e) + O(|e|^2),
/// are
///
///   Ad_X = [ R   (y, -x)^T ]        J(d) = [ M(a)^T   c ]        c = [ a C u - B v ]
///          [ 0       1     ],              [   0      1 ],           [ B u + a C v ]
///
/// (Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eqs.
/// 156-163, with both quotients written by B and C, which keep their digits at small angles).
/// Matrices are row-major.

#include <cmath>

#include "core/geometry/rotation.h"
#include "core/geometry/rotation_log.h"

namespace bundle {

inline void ExpPlanarMotion(const double d[3], double x[3]) {
  const RotationCoefficients k = ExpCoefficients(d[2] * d[2]);
  const double ab = d[2] * k.b;
  const double moved[2] = {k.a * d[0] - ab * d[1], ab * d[0] + k.a * d[1]};
  x[0] = moved[0];
  x[1] = moved[1];
  x[2] = d[2];
}

/// Of an angle in [-pi, pi], whatever turns the motion's own has.
inline void LogPlanarMotion(const double x[3], double d[3]) {
  const double a = WrapAngle(x[2]);
  const double diagonal = 1 - a * a * LogCoefficient(a * a);
  const double moved[2] = {diagonal * x[0] + 0.5 * a * x[1], diagonal * x[1] - 0.5 * a * x[0]};
  d[0] = moved[0];
  d[1] = moved[1];
  d[2] = a;
}

/// out = a b, the motion b followed by a. Angles add up; turns stay.
inline void ComposePlanarMotions(const double a[3], const double b[3], double out[3]) {
  const double c = std::cos(a[2]), s = std::sin(a[2]);
  const double moved[2] = {c * b[0] - s * b[1] + a[0], s * b[0] + c * b[1] + a[1]};
  out[2] = a[2] + b[2];
  out[0] = moved[0];
  out[1] = moved[1];
}

/// out = a^-1 b
inline void PlanarMotionBetween(const double a[3], const double b[3], double out[3]) {
  const double c = std::cos(a[2]), s = std::sin(a[2]);
  const double apart[2] = {b[0] - a[0], b[1] - a[1]};
  out[2] = b[2] - a[2];
  out[0] = c * apart[0] + s * apart[1];
  out[1] = c * apart[1] - s * apart[0];
}

inline void AdjointOfPlanarMotion(const double x[3], double out[9]) {
  const double c = std::cos(x[2]), s = std::sin(x[2]);
  const double adjoint[9] = {c, -s, x[1], s, c, -x[0], 0, 0, 1};
  for (int i = 0; i < 9; ++i) out[i] = adjoint[i];
}

inline void RightJacobianOfPlanarMotion(const double d[3], double out[9]) {
  const RotationCoefficients k = ExpCoefficients(d[2] * d[2]);
  const double ab = d[2] * k.b, ac = d[2] * k.c;
  const double jacobian[9] = {k.a, ab, ac * d[0] - k.b * d[1], -ab, k.a, k.b * d[0] + ac * d[1], 0,
                              0,   1};
  for (int i = 0; i < 9; ++i) out[i] = jacobian[i];
}

/// [ M^-T  -M^-T c ]
/// [  0       1    ], regular for |a| < 2 pi.
inline void InverseRightJacobianOfPlanarMotion(const double d[3], double out[9]) {
  double jacobian[9];
  RightJacobianOfPlanarMotion(d, jacobian);
  const double half = 0.5 * d[2], diagonal = 1 - d[2] * d[2] * LogCoefficient(d[2] * d[2]);
  const double* c = jacobian;
  const double inverse[9] = {diagonal, -half,    -diagonal * c[2] + half * c[5],
                             half,     diagonal, -half * c[2] - diagonal * c[5],
                             0,        0,        1};
  for (int i = 0; i < 9; ++i) out[i] = inverse[i];
}

}  // namespace bundle
