#pragma once

/// Rotations of three-space: the exponential map, its left Jacobian, logarithms, and unit
/// quaternions.
///
/// For w in R^3 with angle a = |w| and W = [w]x (the matrix with W v = w x v), Rodrigues' formula
/// is
///
///   Exp(w) = I + A W + B W^2,         A = sin(a) / a,      B = (1 - cos(a)) / a^2,
///
/// and the left Jacobian, defined by Exp(w + d) = Exp(J_l(w) d) Exp(w) + O(|d|^2), is
///
///   J_l(w) = I + B W + C W^2,         C = (a - sin(a)) / a^3
///
/// (Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eq. 145).
/// All three coefficients are entire functions of a^2. For small a, the formula of C loses its
/// digits. Below a^2 = 1/4 we use their Taylor series to a^12, whose first dropped term is below
/// 5e-17 of the sum. Most steps of a solve are that small, and a series is faster than sines.
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
/// Bernoulli's numbers; seven terms are sufficient below a^2 = 1/4, where the formula begins to
/// lose digits.
///
/// Matrices are 3x3, row-major. Quaternions are stored as COLMAP stores them: x y z w. Functions of
/// a type T take numbers or several at a time (pose_graph/kernels), for which the coefficients have
/// overloads.

#include <cmath>

namespace bundle {

struct RotationCoefficients {
  double a, b, c;
};

/// 1 / k!
struct InverseFactorials {
  double of[38];
  constexpr InverseFactorials() : of() {
    double factorial = 1;
    for (int k = 0; k < 38; ++k) {
      if (k > 0) factorial *= k;
      of[k] = 1 / factorial;
    }
  }
};
inline constexpr InverseFactorials kInverseFactorials;

/// sum (-s)^n / (2n + k)! up to s^6
inline double SmallAngleSeries(double s, int k) {
  double sum = 0;
  for (int n = 6; n >= 0; --n) sum = kInverseFactorials.of[2 * n + k] - s * sum;
  return sum;
}

/// A, B and C of the derivation above, as functions of the squared angle.
inline RotationCoefficients ExpCoefficients(double angle_squared) {
  const double s = angle_squared;
  if (s < 0.25) return {SmallAngleSeries(s, 1), SmallAngleSeries(s, 2), SmallAngleSeries(s, 3)};
  const double angle = std::sqrt(s);
  // 1 - cos(a) = 2 sin^2(a/2) keeps its digits for small a.
  const double sin_half = std::sin(0.5 * angle);
  const double sin_angle = std::sin(angle);
  return {sin_angle / angle, 2 * sin_half * sin_half / s, (angle - sin_angle) / (s * angle)};
}

/// out = I + p [w]x + q [w]x^2
template <typename T>
void SkewPolynomial(const T w[3], T p, T q, T out[9]) {
  const T xx = w[0] * w[0], yy = w[1] * w[1], zz = w[2] * w[2];
  const T xy = w[0] * w[1], xz = w[0] * w[2], yz = w[1] * w[2];
  out[0] = 1 - q * (yy + zz);
  out[1] = q * xy - p * w[2];
  out[2] = q * xz + p * w[1];
  out[3] = q * xy + p * w[2];
  out[4] = 1 - q * (xx + zz);
  out[5] = q * yz - p * w[0];
  out[6] = q * xz - p * w[1];
  out[7] = q * yz + p * w[0];
  out[8] = 1 - q * (xx + yy);
}

/// out = [v]x
template <typename T>
void Skew(const T v[3], T out[9]) {
  const T skew[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
  for (int i = 0; i < 9; ++i) out[i] = skew[i];
}

inline void ExpRotation(const double w[3], double rotation[9], double left_jacobian[9]) {
  const RotationCoefficients k = ExpCoefficients(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  SkewPolynomial(w, k.a, k.b, rotation);
  SkewPolynomial(w, k.b, k.c, left_jacobian);
}

/// The quaternion (x y z w) of Exp(w).
inline void ExpQuaternion(const double w[3], double q[4]) {
  const double angle_squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
  const RotationCoefficients half = ExpCoefficients(0.25 * angle_squared);
  for (int i = 0; i < 3; ++i) q[i] = 0.5 * half.a * w[i];
  q[3] = 1 - 0.25 * angle_squared * half.b;  // cos(a) = 1 - a^2 B
}

/// The rotation of a quaternion (x y z w) of any nonzero norm.
template <typename T>
void QuaternionToRotation(const T q[4], T rotation[9]) {
  const T x = q[0], y = q[1], z = q[2], w = q[3];
  const T s = 2 / (x * x + y * y + z * z + w * w);
  rotation[0] = 1 - s * (y * y + z * z);
  rotation[1] = s * (x * y - z * w);
  rotation[2] = s * (x * z + y * w);
  rotation[3] = s * (x * y + z * w);
  rotation[4] = 1 - s * (x * x + z * z);
  rotation[5] = s * (y * z - x * w);
  rotation[6] = s * (x * z - y * w);
  rotation[7] = s * (y * z + x * w);
  rotation[8] = 1 - s * (x * x + y * y);
}

/// out = a b, the rotation b followed by a.
template <typename T>
void QuaternionProduct(const T a[4], const T b[4], T out[4]) {
  out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
  out[1] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0];
  out[2] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3];
  out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
}

/// Without overflow and underflow.
inline double QuaternionNorm(const double q[4]) {
  return std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
}

inline void NormalizeQuaternion(double q[4]) {
  const double norm = QuaternionNorm(q);
  for (int j = 0; j < 4; ++j) q[j] /= norm;
}

template <typename T>
void MatrixVector3(const T m[9], const T v[3], T out[3]) {
  out[0] = m[0] * v[0] + m[1] * v[1] + m[2] * v[2];
  out[1] = m[3] * v[0] + m[4] * v[1] + m[5] * v[2];
  out[2] = m[6] * v[0] + m[7] * v[1] + m[8] * v[2];
}

/// out = v^T m
template <typename T>
void VectorMatrix3(const T v[3], const T m[9], T out[3]) {
  out[0] = v[0] * m[0] + v[1] * m[3] + v[2] * m[6];
  out[1] = v[0] * m[1] + v[1] * m[4] + v[2] * m[7];
  out[2] = v[0] * m[2] + v[1] * m[5] + v[2] * m[8];
}

template <typename T>
void MatrixProduct3(const T a[9], const T b[9], T out[9]) {
  for (int row = 0; row < 3; ++row) VectorMatrix3(a + 3 * row, b, out + 3 * row);
}

/// out = a^T b
inline void TransposedProduct3(const double* a, const double* b, double* out) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[3 * r + c] = a[r] * b[c] + a[3 + r] * b[3 + c] + a[6 + r] * b[6 + c];
    }
  }
}

inline void Cross3(const double a[3], const double b[3], double out[3]) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

/// An angle in [-pi, pi] that differs from the given one by whole turns. The remainder is exact,
/// and so are the differences, but the function takes ten times as long.
inline double WrapAngle(double angle) {
  if (std::abs(angle) <= M_PI) return angle;
  if (std::abs(angle) < 3 * M_PI) return angle > 0 ? angle - 2 * M_PI : angle + 2 * M_PI;
  return std::remainder(angle, 2 * M_PI);
}

/// 2 atan2(sine, cosine) / sine, of a half angle in [0, pi / 2] and any norm.
inline double LogFactor(double sine, double cosine) {
  // atan2(y, x) / y ~ 1 / x where y is negligible compared with x; the next term is of the order of
  // y^2.
  return sine < 1e-9 * cosine ? 2 / cosine : 2 * std::atan2(sine, cosine) / sine;
}

/// 1, or -1 below zero.
inline double SignOf(double x) { return x < 0 ? -1 : 1; }

inline double Sqrt(double x) { return std::sqrt(x); }

/// The rotation vector of a quaternion (x y z w) of any nonzero norm, of an angle of at most pi.
template <typename T>
void LogQuaternion(const T q[4], T w[3]) {
  const T sign = SignOf(q[3]);
  const T factor = sign * LogFactor(Sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), sign * q[3]);
  for (int i = 0; i < 3; ++i) w[i] = factor * q[i];
}

/// A quaternion (x y z w), not normalised, of a rotation matrix (Shepperd, "Quaternion from
/// rotation matrix", 1978: the largest component comes from a square root).
inline void QuaternionFromRotation(const double* m, double q[4]) {
  const double trace = m[0] + m[4] + m[8];
  int largest = 3;
  double most = trace;
  for (int i = 0; i < 3; ++i) {
    if (m[4 * i] > most) {
      most = m[4 * i];
      largest = i;
    }
  }
  if (largest == 3) {
    q[3] = 1 + trace;
    q[0] = m[7] - m[5];
    q[1] = m[2] - m[6];
    q[2] = m[3] - m[1];
  } else {
    const int i = largest, j = (i + 1) % 3, k = (i + 2) % 3;
    q[i] = 1 + 2 * m[4 * i] - trace;
    q[j] = m[3 * j + i] + m[3 * i + j];
    q[k] = m[3 * k + i] + m[3 * i + k];
    q[3] = m[3 * k + j] - m[3 * j + k];
  }
}

/// The rotation vector of a rotation matrix, of an angle of at most pi.
inline void LogRotation(const double* m, double w[3]) {
  double q[4];
  QuaternionFromRotation(m, q);
  LogQuaternion(q, w);
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
template <typename T>
void InverseLeftJacobian(const T w[3], T out[9]) {
  SkewPolynomial(w, T(-0.5), LogCoefficient(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), out);
}

/// J_l(w)
inline void LeftJacobian(const double w[3], double out[9]) {
  const RotationCoefficients k = ExpCoefficients(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  SkewPolynomial(w, k.b, k.c, out);
}

}  // namespace bundle
