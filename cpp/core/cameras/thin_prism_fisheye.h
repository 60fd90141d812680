#pragma once

/// THIN_PRISM_FISHEYE (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1): radial, tangential and
/// thin prism distortion of the equidistant projection.
///
/// With (u, v) of equidistant.h, s = u^2 + v^2, d(s) = 1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4 and the
/// tangential part (t_u, t_v) of decentering.h
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

#include <algorithm>

#include "core/cameras/decentering.h"
#include "core/cameras/equidistant.h"
#include "core/cameras/lens.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

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

}  // namespace bundle
