#pragma once

/// OpenCV's models: radial and tangential distortion of the perspective projection.

#include <cmath>

#include "core/cameras/camera_model.h"
#include "core/cameras/perspective.h"

namespace bundle {

/// The tangential part of Brown's distortion (1966), of coefficients p1 and p2.
///
/// With s = u^2 + v^2
///
///   t_u = 2 p1 u v + p2 (s + 2 u^2),   t_v = 2 p2 u v + p1 (s + 2 v^2),
///   dt_u/du = 2 p1 v + 6 p2 u,   dt_u/dv = dt_v/du = 2 p1 u + 2 p2 v,   dt_v/dv = 2 p2 u + 6 p1 v,
///   dt_u/d(p1, p2) = (2 u v, s + 2 u^2),   dt_v/d(p1, p2) = (s + 2 v^2, 2 u v).
template <typename T>
struct Decentering {
  T u, v;                 ///< t_u, t_v
  T du_du, cross, dv_dv;  ///< dt_u/du; dt_u/dv = dt_v/du; dt_v/dv
  T du_dp1, du_dp2, dv_dp1, dv_dp2;

  Decentering(T p1, T p2, T x, T y)
      : du_du(2 * p1 * y + 6 * p2 * x),
        cross(2 * (p1 * x + p2 * y)),
        dv_dv(2 * p2 * x + 6 * p1 * y),
        du_dp1(2 * x * y),
        du_dp2(3 * x * x + y * y),
        dv_dp1(x * x + 3 * y * y),
        dv_dp2(du_dp1) {
    u = p1 * du_dp1 + p2 * du_dp2;
    v = p2 * dv_dp2 + p1 * dv_dp1;
  }
};

/// OPENCV (fx, fy, cx, cy, k1, k2, p1, p2): radial and tangential distortion (Brown, 1966).
///
/// With u = X / Z, v = Y / Z, s = u^2 + v^2, d(s) = 1 + k1 s + k2 s^2 and the tangential part (t_u,
/// t_v) of Decentering
///
///   u_d = d u + t_u,   v_d = d v + t_v.
///
/// With d' = k1 + 2 k2 s
///
///   du_d/du = d + 2 d' u^2 + dt_u/du,   du_d/dv = dv_d/du = 2 d' u v + dt_u/dv,
///   dv_d/dv = d + 2 d' v^2 + dt_v/dv,   du_d/d(k1, k2) = (s u, s^2 u),
///   dv_d/d(k1, k2) = (s v, s^2 v).
///
/// Source: COLMAP, src/colmap/sensor/models.h; OpenCV, calib3d, projectPoints.
struct BrownDistortion {
  static constexpr int kNumParams = 4;
  static constexpr bool kIsPolynomial = true;

  template <typename T>
  static bool Distort(const T* k, T u, T v, T* uv_d, T* d_uv, T* d_k) {
    const T s = u * u + v * v;
    const EvenPolynomial<2, T> d(k, s);
    const Decentering<T> t(k[2], k[3], u, v);
    uv_d[0] = d.value * u + t.u;
    uv_d[1] = d.value * v + t.v;
    if (d_uv != nullptr) {
      const T slope = 2 * d.slope;
      d_uv[0] = d.value + slope * u * u + t.du_du;
      d_uv[1] = d_uv[2] = slope * u * v + t.cross;
      d_uv[3] = d.value + slope * v * v + t.dv_dv;
    }
    if (d_k != nullptr) {
      d_k[0] = s * u, d_k[1] = s * s * u, d_k[2] = t.du_dp1, d_k[3] = t.du_dp2;
      d_k[4] = s * v, d_k[5] = s * s * v, d_k[6] = t.dv_dp1, d_k[7] = t.dv_dp2;
    }
    return true;
  }
};

struct OpenCv : Lens<Perspective, BrownDistortion, 2> {
  static constexpr char kName[] = "OPENCV";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"p1", CameraParam::kExtra},          {"p2", CameraParam::kExtra}};
};

/// FULL_OPENCV (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6): OPENCV with a rational radial
/// factor.
///
/// With u = X / Z, v = Y / Z, s = u^2 + v^2, n(s) = 1 + k1 s + k2 s^2 + k3 s^3, m(s) = 1 + k4 s +
/// k5 s^2 + k6 s^3, d = n / m and the tangential part (t_u, t_v) of Decentering
///
///   u_d = d u + t_u,   v_d = d v + t_v.
///
/// With d' = (n' - d m') / m
///
///   du_d/du = d + 2 d' u^2 + dt_u/du,   du_d/dv = dv_d/du = 2 d' u v + dt_u/dv,
///   dv_d/dv = d + 2 d' v^2 + dt_v/dv,
///   dd/d(k1, k2, k3) = (s, s^2, s^3) / m,   dd/d(k4, k5, k6) = -d (s, s^2, s^3) / m,
///
/// the latter times u or v. Where m is zero there is no value.
///
/// Source: COLMAP, src/colmap/sensor/models.h; OpenCV, calib3d, projectPoints.
struct RationalDistortion {
  static constexpr int kNumParams = 8;
  static constexpr bool kIsPolynomial = false;

  static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
                      double* d_k) {
    const double s = u * u + v * v;
    const double above[] = {k[0], k[1], k[4]};
    const EvenPolynomial<3, double> n(above, s);
    const EvenPolynomial<3, double> m(k + 5, s);
    const double d = n.value / m.value;
    if (!std::isfinite(d)) return false;
    const Decentering<double> t(k[2], k[3], u, v);
    uv_d[0] = d * u + t.u;
    uv_d[1] = d * v + t.v;
    if (d_uv != nullptr) {
      const double slope = 2 * (n.slope - d * m.slope) / m.value;
      d_uv[0] = d + slope * u * u + t.du_du;
      d_uv[1] = d_uv[2] = slope * u * v + t.cross;
      d_uv[3] = d + slope * v * v + t.dv_dv;
    }
    if (d_k != nullptr) {
      const double s1 = s / m.value, s2 = s * s1, s3 = s * s2;
      const double row[] = {s1, s2, 0, 0, s3, -d * s1, -d * s2, -d * s3};
      for (int j = 0; j < kNumParams; ++j) d_k[j] = row[j] * u, d_k[kNumParams + j] = row[j] * v;
      d_k[2] = t.du_dp1, d_k[3] = t.du_dp2;
      d_k[kNumParams + 2] = t.dv_dp1, d_k[kNumParams + 3] = t.dv_dp2;
    }
    return true;
  }
};

struct FullOpenCv : Lens<Perspective, RationalDistortion, 2> {
  static constexpr char kName[] = "FULL_OPENCV";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"p1", CameraParam::kExtra},          {"p2", CameraParam::kExtra},
      {"k3", CameraParam::kExtra},          {"k4", CameraParam::kExtra},
      {"k5", CameraParam::kExtra},          {"k6", CameraParam::kExtra}};
};

}  // namespace bundle
