#pragma once

/// RAD_TAN_THIN_PRISM_FISHEYE (fx, fy, cx, cy, k0..k5, p0, p1, s0..s3): radial distortion of the
/// equidistant projection, then tangential and thin prism distortion of what that gives.
///
/// With (u, v) of equidistant.h, s = u^2 + v^2 and d(s) = 1 + k0 s + ... + k5 s^6, first
///
///   a = d u,   b = d v                                          (radial_polynomial.h)
///
/// and then, with q = a^2 + b^2 and the tangential part (t_a, t_b) of decentering.h, whose p1 is p1
/// here and whose p2 is p0,
///
///   u_d = a + t_a + s0 q + s1 q^2,   v_d = b + t_b + s2 q + s3 q^2.
///
/// The second step has the derivative M by (a, b), with dq/da = 2a and dq/db = 2b,
///
///   M = (1 + dt_a/da + 2a (s0 + 2 s1 q),   dt_a/db + 2b (s0 + 2 s1 q))
///       (dt_b/da + 2a (s2 + 2 s3 q),   1 + dt_b/db + 2b (s2 + 2 s3 q)),
///
/// whence d(u_d, v_d)/d(u, v) = M d(a, b)/d(u, v) and d(u_d, v_d)/dk = M d(a, b)/dk. The others act
/// on the second step alone: p0 and p1 as in decentering.h, and
///
///   du_d/d(s0, s1) = dv_d/d(s2, s3) = (q, q^2).
///
/// Source: COLMAP, src/colmap/sensor/models.h; Project Aria's Fisheye624.

#include <algorithm>

#include "core/cameras/decentering.h"
#include "core/cameras/equidistant.h"
#include "core/cameras/lens.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct RadTanThinPrismDistortion {
  static constexpr int kNumParams = 12;
  static constexpr bool kIsPolynomial = false;

  static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
                      double* d_k) {
    constexpr int kNumRadial = 6;
    using Radial = RadialPolynomial<kNumRadial>;
    double ab[2], d_ab_uv[4], d_ab_k[2 * kNumRadial];
    Radial::Distort(k, u, v, ab, d_uv != nullptr ? d_ab_uv : nullptr,
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
