#pragma once

/// SIMPLE_PINHOLE (f, cx, cy): no distortion, square pixels.
///
///   x = f u + cx,  y = f v + cy          dx/du = f, dy/dv = f, dx/df = u, dy/df = v.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/perspective.h"

namespace bundle {

struct SimplePinhole {
  static constexpr char kName[] = "SIMPLE_PINHOLE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    const double f = params[0];
    const Perspective p(point);
    if (p.status == Projection::kUndefined) return p.status;
    xy[0] = f * p.u + params[1];
    xy[1] = f * p.v + params[2];
    if (d_point != nullptr) {
      p.ChainRow(f, 0, d_point);
      p.ChainRow(0, f, d_point + 3);
    }
    if (d_params != nullptr) {
      d_params[0] = p.u, d_params[1] = 1, d_params[2] = 0;
      d_params[3] = p.v, d_params[4] = 0, d_params[5] = 1;
    }
    return p.status;
  }
};

}  // namespace bundle
