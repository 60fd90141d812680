#pragma once

/// Fisheye lenses with radial, tangential and thin prism distortion.

#include <algorithm>

#include "core/cameras/camera_model.h"
#include "core/cameras/fisheye.h"
#include "core/cameras/opencv.h"
#include "core/cameras/perspective.h"

namespace bundle {

/// THIN_PRISM_FISHEYE (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1): radial, tangential and
/// thin prism distortion of the equidistant projection.
///
/// With (u, v) of fisheye.h, s = u^2 + v^2, d(s) = 1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4 and the
/// tangential part (t_u, t_v) of opencv.h
///
///   u_d = d u + t_u + sx1 s,   v_d = d v + t_v + sy1 s.
///
/// With d' = k1 + 2 k2 s + 3 k3 s^2 + 4 k4 s^3
///
///   du_d/du = d + 2 d' u^2 + dt_u/du + 2 sx1 u,   du_d/dv = 2 d' u v + dt_u/dv + 2 sx1 v,
///   dv_d/dv = d + 2 d' v^2 + dt_v/dv + 2 sy1 v,   dv_d/du = 2 d' u v + dt_v/du + 2 sy1 u,
///   du_d/dkj = s^j u,   dv_d/dkj = s^j v,   du_d/dsx1 = dv_d/dsy1 = s.
///
/// Source: COLMAP, src/colmap/sensor/models.h, after Weng, Cohen and Herniou, PAMI 1992.
struct ThinPrismDistortion {
  static constexpr int kNumParams = 8;
  static constexpr bool kIsPolynomial = false;

  static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
                      double* d_k) {
    const double s = u * u + v * v;
    const double radial[] = {k[0], k[1], k[4], k[5]};
    const double sx = k[6], sy = k[7];
    const EvenPolynomial<4, double> d(radial, s);
    const Decentering<double> t(k[2], k[3], u, v);
    uv_d[0] = d.value * u + t.u + sx * s;
    uv_d[1] = d.value * v + t.v + sy * s;
    if (d_uv != nullptr) {
      const double slope = 2 * d.slope;
      const double cross = slope * u * v + t.cross;
      d_uv[0] = d.value + slope * u * u + t.du_du + 2 * sx * u;
      d_uv[1] = cross + 2 * sx * v;
      d_uv[2] = cross + 2 * sy * u;
      d_uv[3] = d.value + slope * v * v + t.dv_dv + 2 * sy * v;
    }
    if (d_k != nullptr) {
      const double s2 = s * s, s3 = s2 * s, s4 = s3 * s;
      const double row_u[] = {s * u, s2 * u, t.du_dp1, t.du_dp2, s3 * u, s4 * u, s, 0};
      const double row_v[] = {s * v, s2 * v, t.dv_dp1, t.dv_dp2, s3 * v, s4 * v, 0, s};
      std::copy_n(row_u, 8, d_k);
      std::copy_n(row_v, 8, d_k + 8);
    }
    return true;
  }
};

struct ThinPrismFisheye : Lens<Equidistant, ThinPrismDistortion, 2> {
  static constexpr char kName[] = "THIN_PRISM_FISHEYE";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"p1", CameraParam::kExtra},          {"p2", CameraParam::kExtra},
      {"k3", CameraParam::kExtra},          {"k4", CameraParam::kExtra},
      {"sx1", CameraParam::kExtra},         {"sy1", CameraParam::kExtra}};
};

/// RAD_TAN_THIN_PRISM_FISHEYE (fx, fy, cx, cy, k0..k5, p0, p1, s0..s3): radial distortion of the
/// equidistant projection, then tangential and thin prism distortion of the result.
///
/// With (u, v) of fisheye.h, s = u^2 + v^2 and d(s) = 1 + k0 s + ... + k5 s^6, first
///
///   a = d u,   b = d v                                          (perspective.h)
///
/// and then, with q = a^2 + b^2 and the tangential part (t_a, t_b) of opencv.h, whose p1 is p1
/// here and whose p2 is p0,
///
///   u_d = a + t_a + s0 q + s1 q^2,   v_d = b + t_b + s2 q + s3 q^2.
///
/// The second step has the derivative M with respect to (a, b), with dq/da = 2a and dq/db = 2b,
///
///   M = (1 + dt_a/da + 2a (s0 + 2 s1 q),   dt_a/db + 2b (s0 + 2 s1 q))
///       (dt_b/da + 2a (s2 + 2 s3 q),   1 + dt_b/db + 2b (s2 + 2 s3 q)),
///
/// whence d(u_d, v_d)/d(u, v) = M d(a, b)/d(u, v) and d(u_d, v_d)/dk = M d(a, b)/dk. All other
/// parameters act only on the second step: p0 and p1 as in opencv.h, and
///
///   du_d/d(s0, s1) = dv_d/d(s2, s3) = (q, q^2).
///
/// Source: COLMAP, src/colmap/sensor/models.h; Project Aria's Fisheye624.
struct RadTanThinPrismDistortion {
  static constexpr int kNumParams = 12;
  static constexpr bool kIsPolynomial = false;

  static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
                      double* d_k) {
    constexpr int kNumRadial = 6;
    using Polynomial = RadialPolynomial<kNumRadial>;
    double ab[2], d_ab_uv[4], d_ab_k[2 * kNumRadial];
    Polynomial::Distort(k, u, v, ab, d_uv != nullptr ? d_ab_uv : nullptr,
                        d_k != nullptr ? d_ab_k : nullptr);
    const double a = ab[0], b = ab[1];
    const double q = a * a + b * b;
    const double s0 = k[8], s1 = k[9], s2 = k[10], s3 = k[11];
    const Decentering<double> t(k[7], k[6], a, b);
    uv_d[0] = a + t.u + q * (s0 + s1 * q);
    uv_d[1] = b + t.v + q * (s2 + s3 * q);
    const double prism_u = 2 * (s0 + 2 * s1 * q), prism_v = 2 * (s2 + 2 * s3 * q);
    const double m[] = {1 + t.du_du + prism_u * a, t.cross + prism_u * b, t.cross + prism_v * a,
                        1 + t.dv_dv + prism_v * b};
    if (d_uv != nullptr) Product<2>(m, d_ab_uv, 2, d_uv);
    if (d_k != nullptr) {
      Product<kNumRadial>(m, d_ab_k, kNumParams, d_k);
      const double row_u[] = {t.du_dp2, t.du_dp1, q, q * q, 0, 0};
      const double row_v[] = {t.dv_dp2, t.dv_dp1, 0, 0, q, q * q};
      std::copy_n(row_u, 6, d_k + kNumRadial);
      std::copy_n(row_v, 6, d_k + kNumParams + kNumRadial);
    }
    return true;
  }

 private:
  /// The product of m (2x2) and x (2 x kColumns), into rows that are `stride` apart.
  template <int kColumns>
  static void Product(const double* m, const double* x, int stride, double* out) {
    for (int row = 0; row < 2; ++row) {
      for (int j = 0; j < kColumns; ++j) {
        out[row * stride + j] = m[2 * row] * x[j] + m[2 * row + 1] * x[kColumns + j];
      }
    }
  }
};

struct RadTanThinPrismFisheye : Lens<Equidistant, RadTanThinPrismDistortion, 2> {
  static constexpr char kName[] = "RAD_TAN_THIN_PRISM_FISHEYE";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k0", CameraParam::kExtra},          {"k1", CameraParam::kExtra},
      {"k2", CameraParam::kExtra},          {"k3", CameraParam::kExtra},
      {"k4", CameraParam::kExtra},          {"k5", CameraParam::kExtra},
      {"p0", CameraParam::kExtra},          {"p1", CameraParam::kExtra},
      {"s0", CameraParam::kExtra},          {"s1", CameraParam::kExtra},
      {"s2", CameraParam::kExtra},          {"s3", CameraParam::kExtra}};
};

}  // namespace bundle
