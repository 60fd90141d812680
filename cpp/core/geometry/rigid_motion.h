#pragma once

/// Rigid motions of the plane and of space.
///
/// SE(2): rigid motions of the plane, their exponential map, logarithm, adjoint and right Jacobian.
///
/// A motion is stored as x y angle (units of length, radians), a tangent vector d = (u, v, a) in
/// the same order. With sin a / a =: A and (1 - cos a)/a =: aB (B and C as in rotation.h)
///
///   Exp(d) = (M(a) (u, v), a),      M(a) = [ A  -aB ]      M(a)^-1 = [ 1 - a^2 D    a/2     ]
///                                          [ aB   A ],              [ -a/2      1 - a^2 D  ],
///
/// where D is that of rotation.h: (a/2) cot(a/2) = 1 - a^2 D. The adjoint,
/// X Exp(d) X^-1 = Exp(Ad_X d), and the right Jacobian, Exp(d + e) = Exp(d) Exp(J e) + O(|e|^2),
/// are
///
///   Ad_X = [ R   (y, -x)^T ]        J(d) = [ M(a)^T   c ]        c = [ a C u - B v ]
///          [ 0       1     ],              [   0      1 ],           [ B u + a C v ]
///
/// (Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eqs.
/// 156-163, with both quotients written by B and C, which keep their digits at small angles).
///
/// SE(3): rigid motions x -> R x + t, their exponential map, logarithm, adjoint and left Jacobian.
///
/// A motion is stored as COLMAP stores a pose: qx qy qz qw tx ty tz. A tangent vector is
/// d = (w, v), rotation first, in radians and units of length. With W = [w]x and J_l of rotation.h
///
///   Exp(d) = (Exp(w), J_l(w) v),        Log(R, t) = (Log(R), J_l(Log R)^-1 t)
///
/// (Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eqs.
/// 172-174). The adjoint, X Exp(d) X^-1 = Exp(Ad_X d), and the left Jacobian,
/// Exp(d + e) = Exp(J e) Exp(d) + O(|e|^2), are in this order
///
///   Ad_X = [ R       0 ]        J(w, v) = [ J_l(w)     0    ]
///          [ [t]x R  R ],                 [ Q(w, v)  J_l(w) ],
///
/// where, with V = [v]x and C = (a - sin a)/a^3, E = (a^2/2 + cos a - 1)/a^4,
/// F = (sin a - a + a^3/6)/a^5 (Barfoot, "State Estimation for Robotics", 2017, eq. 7.86),
///
///   Q = 1/2 V + C (WV + VW + WVW) + E (WWV + VWW - 3 WVW) + 1/2 (E - 3 F) (WVWW + WWVW).
///
/// C, E and F are entire functions of s = a^2: sum (-s)^n / (2n + k)! with k = 3, 4, 5. Nine terms
/// are sufficient below s = 1; above, the formulas lose at most two digits. The inverse is
///
///   J^-1 = [ J_l^-1               0     ]
///          [ -J_l^-1 Q J_l^-1   J_l^-1  ].
///
/// The right Jacobian at d is the left Jacobian at -d. Matrices are row-major.

#include <cmath>

#include "core/geometry/rotation.h"

namespace bundle {

inline void ExpPlanarMotion(const double d[3], double x[3]) {
  const RotationCoefficients k = ExpCoefficients(d[2] * d[2]);
  const double ab = d[2] * k.b;
  const double moved[2] = {k.a * d[0] - ab * d[1], ab * d[0] + k.a * d[1]};
  x[0] = moved[0];
  x[1] = moved[1];
  x[2] = d[2];
}

/// Logarithm with an angle in [-pi, pi], also if the angle of the motion is larger.
inline void LogPlanarMotion(const double x[3], double d[3]) {
  const double a = WrapAngle(x[2]);
  const double diagonal = 1 - a * a * LogCoefficient(a * a);
  const double moved[2] = {diagonal * x[0] + 0.5 * a * x[1], diagonal * x[1] - 0.5 * a * x[0]};
  d[0] = moved[0];
  d[1] = moved[1];
  d[2] = a;
}

/// out = a b, the motion b followed by a. Angles are added and not reduced to one turn.
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

inline void ExpRigidMotion(const double d[6], double x[7]) {
  double left_jacobian[9];
  ExpQuaternion(d, x);
  LeftJacobian(d, left_jacobian);
  MatrixVector3(left_jacobian, d + 3, x + 4);
}

inline void LogRigidMotion(const double x[7], double d[6]) {
  double inverse[9];
  LogQuaternion(x, d);
  InverseLeftJacobian(d, inverse);
  MatrixVector3(inverse, x + 4, d + 3);
}

/// out = a b, the motion b followed by a.
inline void ComposeRigidMotions(const double a[7], const double b[7], double out[7]) {
  double rotation[9], moved[3];
  QuaternionToRotation(a, rotation);
  MatrixVector3(rotation, b + 4, moved);
  QuaternionProduct(a, b, out);
  for (int i = 0; i < 3; ++i) out[4 + i] = moved[i] + a[4 + i];
}

/// out = a^-1 b. Translations are subtracted before they are rotated, so that no digits are lost
/// far from the origin.
inline void RigidMotionBetween(const double a[7], const double b[7], double out[7]) {
  double rotation[9];
  const double conjugate[4] = {-a[0], -a[1], -a[2], a[3]};
  const double apart[3] = {b[4] - a[4], b[5] - a[5], b[6] - a[6]};
  QuaternionToRotation(a, rotation);
  QuaternionProduct(conjugate, b, out);
  VectorMatrix3(apart, rotation, out + 4);
}

namespace internal {

/// Writes a 6x6 matrix with the same block twice on its diagonal and one below.
inline void LowerBlockTriangle(const double diagonal[9], const double below[9], double out[36]) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[6 * r + c] = out[6 * (r + 3) + c + 3] = diagonal[3 * r + c];
      out[6 * (r + 3) + c] = below[3 * r + c];
      out[6 * r + c + 3] = 0;
    }
  }
}

/// sum (-s)^n / (2n + k)! for k = 3, 4 and 5: C, E and F of the derivation above.
inline void MotionCoefficients(double angle_squared, double out[3]) {
  const double s = angle_squared;
  if (s < 1) {
    double factorial = 2;  // (k - 1)!, then (2n + k)!
    for (int k = 3; k <= 5; ++k) {
      factorial *= k;
      double term = 1 / factorial, sum = term;
      for (int n = 1; n < 10; ++n) sum += term *= -s / ((2 * n + k - 1) * (2 * n + k));
      out[k - 3] = sum;
    }
    return;
  }
  const double a = std::sqrt(s);
  out[0] = (a - std::sin(a)) / (s * a);
  out[1] = (0.5 * s + std::cos(a) - 1) / (s * s);
  out[2] = (std::sin(a) - a + s * a / 6) / (s * s * a);
}

/// Q of the derivation above.
inline void MotionCoupling(const double d[6], double out[9]) {
  double w[9], v[9], k[3], wv[9], vw[9], wvw[9], wwv[9], vww[9], wvww[9], wwvw[9];
  Skew(d, w);
  Skew(d + 3, v);
  MotionCoefficients(d[0] * d[0] + d[1] * d[1] + d[2] * d[2], k);
  MatrixProduct3(w, v, wv);
  MatrixProduct3(v, w, vw);
  MatrixProduct3(wv, w, wvw);
  MatrixProduct3(w, wv, wwv);
  MatrixProduct3(vw, w, vww);
  MatrixProduct3(wvw, w, wvww);
  MatrixProduct3(w, wvw, wwvw);
  for (int i = 0; i < 9; ++i) {
    out[i] = 0.5 * v[i] + k[0] * (wv[i] + vw[i] + wvw[i]) + k[1] * (wwv[i] + vww[i] - 3 * wvw[i]) +
             0.5 * (k[1] - 3 * k[2]) * (wvww[i] + wwvw[i]);
  }
}

}  // namespace internal

inline void AdjointOfRigidMotion(const double x[7], double out[36]) {
  double rotation[9], skew[9], below[9];
  QuaternionToRotation(x, rotation);
  Skew(x + 4, skew);
  MatrixProduct3(skew, rotation, below);
  internal::LowerBlockTriangle(rotation, below, out);
}

inline void LeftJacobianOfRigidMotion(const double d[6], double out[36]) {
  double diagonal[9], below[9];
  LeftJacobian(d, diagonal);
  internal::MotionCoupling(d, below);
  internal::LowerBlockTriangle(diagonal, below, out);
}

inline void InverseLeftJacobianOfRigidMotion(const double d[6], double out[36]) {
  double diagonal[9], coupling[9], half[9], below[9];
  InverseLeftJacobian(d, diagonal);
  internal::MotionCoupling(d, coupling);
  MatrixProduct3(diagonal, coupling, half);
  MatrixProduct3(half, diagonal, below);
  for (double& value : below) value = -value;
  internal::LowerBlockTriangle(diagonal, below, out);
}

}  // namespace bundle
