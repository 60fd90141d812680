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
/// With p = w^T v and s = a^2, WV = v w^T - p I, VW = w v^T - p I and WW = w w^T - s I. So
/// WVW = -p W, WVWW = WWVW = -p WW, and WWV + VWW = [w x (w x v)]x - 2 p W = [p w - s v]x - 2 p W:
///
///   Q = C (v w^T + w v^T - 2 p I) - (E - 3 F) p (w w^T - s I)
///       + [ (1/2 - E s) v + (2 E - C) p w ]x.
///
/// C, E and F are entire functions of s: sum (-s)^n / (2n + k)! with k = 3, 4, 5. Nine terms
/// are sufficient below s = 1; above, the formulas lose at most two digits. The inverse is
///
///   J^-1 = [ J_l^-1               0     ]
///          [ -J_l^-1 Q J_l^-1   J_l^-1  ].
///
/// The right Jacobian at d is the left Jacobian at -d. Matrices are row-major.

#include <cmath>

#include "core/geometry/rotation.h"

namespace bundle {

/// The motion and the cosine and sine of its angle.
inline void ExpPlanarMotion(const double d[3], double x[5]) {
  const RotationCoefficients k = ExpCoefficients(d[2] * d[2]);
  const double ab = d[2] * k.b;
  const double moved[2] = {k.a * d[0] - ab * d[1], ab * d[0] + k.a * d[1]};
  x[0] = moved[0];
  x[1] = moved[1];
  x[2] = d[2];
  x[3] = 1 - d[2] * ab;
  x[4] = d[2] * k.a;
}

/// Logarithm with an angle in [-pi, pi], also if the angle of the motion is larger.
template <typename T>
void LogPlanarMotion(const T x[3], T d[3]) {
  const T a = WrapAngle(x[2]);
  const T diagonal = 1 - a * a * LogCoefficient(a * a);
  const T moved[2] = {diagonal * x[0] + 0.5 * a * x[1], diagonal * x[1] - 0.5 * a * x[0]};
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
template <typename T>
void InverseRightJacobianOfPlanarMotion(const T d[3], T out[9]) {
  const auto k = ExpCoefficients(d[2] * d[2]);
  const T half = 0.5 * d[2], diagonal = 1 - d[2] * d[2] * LogCoefficient(d[2] * d[2]);
  const T ac = d[2] * k.c;
  const T c[2] = {ac * d[0] - k.b * d[1], k.b * d[0] + ac * d[1]};
  const T inverse[9] = {diagonal, -half,    half * c[1] - diagonal * c[0],
                        half,     diagonal, -half * c[0] - diagonal * c[1],
                        0,        0,        1};
  for (int i = 0; i < 9; ++i) out[i] = inverse[i];
}

inline void ExpRigidMotion(const double d[6], double x[7]) {
  double left_jacobian[9];
  ExpQuaternion(d, x);
  LeftJacobian(d, left_jacobian);
  MatrixVector3(left_jacobian, d + 3, x + 4);
}

template <typename T>
void LogRigidMotion(const T x[7], T d[6]) {
  T inverse[9];
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
template <typename T>
void RigidMotionBetween(const T a[7], const T b[7], T out[7]) {
  T rotation[9];
  const T conjugate[4] = {-a[0], -a[1], -a[2], a[3]};
  const T apart[3] = {b[4] - a[4], b[5] - a[5], b[6] - a[6]};
  QuaternionToRotation(a, rotation);
  QuaternionProduct(conjugate, b, out);
  VectorMatrix3(apart, rotation, out + 4);
}

namespace internal {

/// Writes a 6x6 matrix with the same block twice on its diagonal and one below.
template <typename T>
void LowerBlockTriangle(const T diagonal[9], const T below[9], T out[36]) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[6 * r + c] = out[6 * (r + 3) + c + 3] = diagonal[3 * r + c];
      out[6 * (r + 3) + c] = below[3 * r + c];
      out[6 * r + c + 3] = 0;
    }
  }
}

/// 1 / ((m + 3) (m + 4)) of m = 0 ... 19.
inline constexpr double kReciprocal[] = {1.0 / 12,  1.0 / 20,  1.0 / 30,  1.0 / 42,  1.0 / 56,
                                         1.0 / 72,  1.0 / 90,  1.0 / 110, 1.0 / 132, 1.0 / 156,
                                         1.0 / 182, 1.0 / 210, 1.0 / 240, 1.0 / 272, 1.0 / 306,
                                         1.0 / 342, 1.0 / 380, 1.0 / 420, 1.0 / 462, 1.0 / 506};

/// sum (-s)^n / (2n + k)! for k = 3, 4 and 5: C, E and F of the derivation above.
inline void MotionCoefficients(double angle_squared, double out[3]) {
  const double s = angle_squared;
  if (s < 1) {
    // Horner's rule: 1/k! (1 - s/((k+1)(k+2)) (1 - s/((k+3)(k+4)) (1 - ...))).
    constexpr double kFirst[3] = {1.0 / 6, 1.0 / 24, 1.0 / 120};
    for (int k = 3; k <= 5; ++k) {
      double sum = 1;
      for (int n = 9; n > 0; --n) sum = 1 - s * kReciprocal[2 * n + k - 4] * sum;
      out[k - 3] = kFirst[k - 3] * sum;
    }
    return;
  }
  const double a = std::sqrt(s);
  out[0] = (a - std::sin(a)) / (s * a);
  out[1] = (0.5 * s + std::cos(a) - 1) / (s * s);
  out[2] = (std::sin(a) - a + s * a / 6) / (s * s * a);
}

/// Q of the derivation above.
template <typename T>
void MotionCoupling(const T d[6], T out[9]) {
  const T *w = d, *v = d + 3;
  const T s = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
  const T p = w[0] * v[0] + w[1] * v[1] + w[2] * v[2];
  T k[3], skew[3];
  MotionCoefficients(s, k);
  const T g = (k[1] - 3 * k[2]) * p;
  for (int i = 0; i < 3; ++i) {
    skew[i] = (0.5 - k[1] * s) * v[i] + (2 * k[1] - k[0]) * p * w[i];
  }
  Skew(skew, out);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[3 * r + c] += k[0] * (v[r] * w[c] + w[r] * v[c]) - g * w[r] * w[c];
    }
    out[4 * r] += g * s - 2 * k[0] * p;
  }
}

}  // namespace internal

template <typename T>
void AdjointOfRigidMotion(const T x[7], T out[36]) {
  T rotation[9], skew[9], below[9];
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

template <typename T>
void InverseLeftJacobianOfRigidMotion(const T d[6], T out[36]) {
  T diagonal[9], coupling[9], half[9], below[9];
  InverseLeftJacobian(d, diagonal);
  internal::MotionCoupling(d, coupling);
  MatrixProduct3(diagonal, coupling, half);
  MatrixProduct3(half, diagonal, below);
  for (T& value : below) value = -value;
  internal::LowerBlockTriangle(diagonal, below, out);
}

}  // namespace bundle
