#pragma once

/// OPENCV (fx, fy, cx, cy, k1, k2, p1, p2): radial and tangential distortion (Brown, 1966).
///
/// With s = u^2 + v^2 and d(s) = 1 + k1 s + k2 s^2
///
///   u_d = d u + 2 p1 u v + p2 (s + 2 u^2),      x = fx u_d + cx,
///   v_d = d v + 2 p2 u v + p1 (s + 2 v^2),      y = fy v_d + cy.
///
/// From ds/du = 2u, ds/dv = 2v and d' = k1 + 2 k2 s
///
///   du_d/du = d + 2 d' u^2 + 2 p1 v + 6 p2 u,   du_d/dv = 2 d' u v + 2 p1 u + 2 p2 v,
///   dv_d/dv = d + 2 d' v^2 + 2 p2 u + 6 p1 v,   dv_d/du = du_d/dv,
///   du_d/d(k1, k2, p1, p2) = (s u, s^2 u, 2 u v, s + 2 u^2),
///   dv_d/d(k1, k2, p1, p2) = (s v, s^2 v, s + 2 v^2, 2 u v).
///
/// Source: COLMAP, src/colmap/sensor/models.h; OpenCV, calib3d, projectPoints.

#include "core/cameras/perspective.h"

namespace bundle {

struct OpenCv {
  static constexpr char kName[] = "OPENCV";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"p1", CameraParam::kExtra},          {"p2", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    const double fx = params[0], fy = params[1];
    const double k1 = params[4], k2 = params[5], p1 = params[6], p2 = params[7];
    const Perspective p(point);
    if (p.status == Projection::kUndefined) return p.status;
    const double u = p.u, v = p.v;
    const double s = u * u + v * v;
    const double factor = 1 + s * (k1 + s * k2);
    const double two_uv = 2 * u * v;
    const double tangential_u = s + 2 * u * u;
    const double tangential_v = s + 2 * v * v;
    const double u_d = factor * u + p1 * two_uv + p2 * tangential_u;
    const double v_d = factor * v + p2 * two_uv + p1 * tangential_v;
    xy[0] = fx * u_d + params[2];
    xy[1] = fy * v_d + params[3];
    if (d_point != nullptr) {
      const double slope = 2 * (k1 + 2 * k2 * s);
      const double cross = slope * u * v + 2 * (p1 * u + p2 * v);
      p.ChainRow(fx * (factor + slope * u * u + 2 * p1 * v + 6 * p2 * u), fx * cross, d_point);
      p.ChainRow(fy * cross, fy * (factor + slope * v * v + 2 * p2 * u + 6 * p1 * v), d_point + 3);
    }
    if (d_params != nullptr) {
      const double row_x[] = {
          u_d, 0, 1, 0, fx * s * u, fx * s * s * u, fx * two_uv, fx * tangential_u};
      const double row_y[] = {0,          v_d, 0, 1, fy * s * v, fy * s * s * v, fy * tangential_v,
                              fy * two_uv};
      for (int i = 0; i < 8; ++i) d_params[i] = row_x[i], d_params[8 + i] = row_y[i];
    }
    return p.status;
  }
};

}  // namespace bundle
