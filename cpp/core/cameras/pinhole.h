#pragma once

/// PINHOLE (fx, fy, cx, cy): no distortion.
///
///   x = fx u + cx,   y = fy v + cy,   u = X / Z,   v = Y / Z.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/lens.h"
#include "core/cameras/perspective.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct Pinhole {
  static constexpr char kName[] = "PINHOLE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return ProjectThroughLens<Perspective, RadialPolynomial<0>, 2>(params, point, xy, d_point,
                                                                   d_params);
  }
};

}  // namespace bundle
