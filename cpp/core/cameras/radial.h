#pragma once

/// SIMPLE_RADIAL (f, cx, cy, k) and RADIAL (f, cx, cy, k1, k2): even polynomial radial distortion.
///
/// With s = u^2 + v^2 and the factor d(s) = 1 + k1 s + k2 s^2 (k2 = 0 for SIMPLE_RADIAL)
///
///   x = f d u + cx,   y = f d v + cy.
///
/// From ds/du = 2u, ds/dv = 2v and d' = k1 + 2 k2 s
///
///   dx/du = f (d + 2 d' u^2),   dx/dv = dy/du = 2 f d' u v,   dy/dv = f (d + 2 d' v^2),
///   dx/df = d u,   dx/dk1 = f s u,   dx/dk2 = f s^2 u,        and with v for y.
///
/// A camera of Bundle Adjustment in the Large is RADIAL with cx = cy = 0 once its frame is turned
/// to look along +z and the image's y axis to point down.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/perspective.h"

namespace bundle {

namespace internal {

/// kNumCoefficients is 1 or 2.
template <int kNumCoefficients>
Projection ProjectRadial(const double* params, const double* point, double* xy, double* d_point,
                         double* d_params) {
  constexpr int kNumParams = 3 + kNumCoefficients;
  const double f = params[0];
  const double k1 = params[3];
  const double k2 = kNumCoefficients == 2 ? params[kNumParams - 1] : 0.0;
  const Perspective p(point);
  if (p.status == Projection::kUndefined) return p.status;
  const double s = p.u * p.u + p.v * p.v;
  const double factor = 1 + s * (k1 + s * k2);
  const double u = factor * p.u, v = factor * p.v;
  xy[0] = f * u + params[1];
  xy[1] = f * v + params[2];
  if (d_point != nullptr) {
    const double slope = 2 * f * (k1 + 2 * k2 * s);
    const double cross = slope * p.u * p.v;
    p.ChainRow(f * factor + slope * p.u * p.u, cross, d_point);
    p.ChainRow(cross, f * factor + slope * p.v * p.v, d_point + 3);
  }
  if (d_params != nullptr) {
    double* row_x = d_params;
    double* row_y = d_params + kNumParams;
    row_x[0] = u, row_x[1] = 1, row_x[2] = 0, row_x[3] = f * s * p.u;
    row_y[0] = v, row_y[1] = 0, row_y[2] = 1, row_y[3] = f * s * p.v;
    if constexpr (kNumCoefficients == 2) {
      row_x[4] = s * row_x[3];
      row_y[4] = s * row_y[3];
    }
  }
  return p.status;
}

}  // namespace internal

struct SimpleRadial {
  static constexpr char kName[] = "SIMPLE_RADIAL";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return internal::ProjectRadial<1>(params, point, xy, d_point, d_params);
  }
};

struct Radial {
  static constexpr char kName[] = "RADIAL";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k1", CameraParam::kExtra},
                                            {"k2", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return internal::ProjectRadial<2>(params, point, xy, d_point, d_params);
  }
};

}  // namespace bundle
