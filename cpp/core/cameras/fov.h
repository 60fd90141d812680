#pragma once

/// FOV (fx, fy, cx, cy, omega): the field-of-view model of Devernay and Faugeras.
///
/// With u = X / Z, v = Y / Z, s = u^2 + v^2, w = omega and t = tan(w / 2)
///
///   u_d = d u,   v_d = d v,   d = atan(2 t sqrt(s)) / (w sqrt(s)),
///
/// where COLMAP, and hence we, have in place of d
///
///   1 - w^2 / 12 + w^2 s / 3                        for w^2 < 1e-4,
///   2 t / w - 8 t^3 s / (3 w)                       else for s < 1e-4.
///
/// The second is the series of d in s. Its relative error is q^2 / 5 with q = 4 t^2 s: 3e-9 at its
/// limit for w = 1, 3e-6 for w = 2.5. The first is the series in w of the inverse mapping, whose
/// terms have the opposite signs to those of d. So d jumps by 2e-4 (s / 3 - 1 / 12) at |w| = 0.01.
/// We keep both series, with their derivatives, because parameters must give the same pixels as in
/// COLMAP; fov_lenses.h moves solves across the jump. With dt/dw = (1 + t^2) / 2 and A(q) =
/// atan(sqrt(q)) / sqrt(q) of fisheye.h,
///
///   d = (2 t / w) A(q),   dd/ds = (2 t / w) 4 t^2 A'(q),   dd/dw = ((1 + t^2) / (1 + q) - d) / w,
///
/// which is finite also at w = pi, where t is infinite; for the series
///
///   dd/ds = w^2 / 3,           dd/dw = 2 w (s / 3 - 1 / 12),
///   dd/ds = -8 t^3 / (3 w),    dd/dw = ((1 + t^2) (1 - 4 t^2 s) - d) / w.
///
/// du_d/du = d + 2 u^2 dd/ds loses digits by cancellation for large s. With c = d + 2 s dd/ds,
/// which is (2 t / w) / (1 + q), and for the series 1 - w^2 / 12 + w^2 s and (2 t / w) (1 - q),
///
///   du_d/du = c - 2 v^2 dd/ds,   du_d/dv = dv_d/du = 2 u v dd/ds,   dv_d/dv = c - 2 u^2 dd/ds.
///
/// Source: COLMAP, src/colmap/sensor/models.h; Devernay and Faugeras, Machine Vision and
/// Applications 2001.

#include <cmath>

#include "core/cameras/camera_model.h"
#include "core/cameras/fisheye.h"
#include "core/cameras/perspective.h"

namespace bundle {

struct FovDistortion {
  static constexpr int kNumParams = 1;
  static constexpr bool kIsPolynomial = false;

  static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
                      double* d_k) {
    const Factor d(k[0], u * u + v * v);
    uv_d[0] = d.value * u;
    uv_d[1] = d.value * v;
    if (d_uv != nullptr) {
      d_uv[0] = d.along - 2 * d.d_s * v * v;
      d_uv[1] = d_uv[2] = 2 * d.d_s * u * v;
      d_uv[3] = d.along - 2 * d.d_s * u * u;
    }
    if (d_k != nullptr) d_k[0] = d.d_omega * u, d_k[1] = d.d_omega * v;
    return true;
  }

 private:
  /// d, its derivatives with respect to s and omega, and c.
  struct Factor {
    double value, along, d_s, d_omega;

    Factor(double omega, double s) {
      constexpr double kSmall = 1e-4;  // COLMAP's
      const double omega2 = omega * omega;
      if (omega2 < kSmall) {
        value = 1 + omega2 * (s / 3 - 1.0 / 12);
        along = 1 + omega2 * (s - 1.0 / 12);
        d_s = omega2 / 3;
        d_omega = 2 * omega * (s / 3 - 1.0 / 12);
        return;
      }
      const double t = std::tan(omega / 2);
      const double slope = 2 * t / omega, q_by_s = 4 * t * t;
      if (s < kSmall) {
        value = slope * (1 - q_by_s * s / 3);
        along = slope * (1 - q_by_s * s);
        d_s = -slope * q_by_s / 3;
        d_omega = ((1 + t * t) * (1 - q_by_s * s) - value) / omega;
      } else {
        const ArctanRatio ratio(q_by_s * s);
        value = slope * ratio.value;
        along = slope / (1 + q_by_s * s);
        d_s = slope * q_by_s * ratio.slope;
        d_omega = ((1 + t * t) / (1 + q_by_s * s) - value) / omega;
      }
    }
  };
};

struct Fov : Lens<Perspective, FovDistortion, 2> {
  static constexpr char kName[] = "FOV";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"omega", CameraParam::kExtra}};
};

}  // namespace bundle
