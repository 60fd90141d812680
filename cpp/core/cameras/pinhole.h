#pragma once

/// PINHOLE (fx, fy, cx, cy): no distortion.
///
///   x = fx u + cx,  y = fy v + cy        dx/du = fx, dy/dv = fy, dx/dfx = u, dy/dfy = v.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/perspective.h"

namespace bundle {

struct Pinhole {
  static constexpr char kName[] = "PINHOLE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    const double fx = params[0], fy = params[1];
    const Perspective p(point);
    if (p.status == Projection::kUndefined) return p.status;
    xy[0] = fx * p.u + params[2];
    xy[1] = fy * p.v + params[3];
    if (d_point != nullptr) {
      p.ChainRow(fx, 0, d_point);
      p.ChainRow(0, fy, d_point + 3);
    }
    if (d_params != nullptr) {
      d_params[0] = p.u, d_params[1] = 0, d_params[2] = 1, d_params[3] = 0;
      d_params[4] = 0, d_params[5] = p.v, d_params[6] = 0, d_params[7] = 1;
    }
    return p.status;
  }
};

}  // namespace bundle
