#pragma once

/// OPENCV (fx, fy, cx, cy, k1, k2, p1, p2): radial and tangential distortion (Brown, 1966).
///
/// With u = X / Z, v = Y / Z, s = u^2 + v^2, d(s) = 1 + k1 s + k2 s^2 and the tangential part (t_u,
/// t_v) of decentering.h
///
///   u_d = d u + t_u,   v_d = d v + t_v.
///
/// With d' = k1 + 2 k2 s
///
///   du_d/du = d + 2 d' u^2 + dt_u/du,   du_d/dv = dv_d/du = 2 d' u v + dt_u/dv,
///   dv_d/dv = d + 2 d' v^2 + dt_v/dv,   du_d/d(k1, k2) = (s u, s^2 u),   dv_d/d(k1, k2) = (s v,
///   s^2 v).
///
/// Source: COLMAP, src/colmap/sensor/models.h; OpenCV, calib3d, projectPoints.

#include "core/cameras/decentering.h"
#include "core/cameras/lens.h"
#include "core/cameras/perspective.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

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

}  // namespace bundle
