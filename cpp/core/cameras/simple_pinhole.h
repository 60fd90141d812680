#pragma once

/// SIMPLE_PINHOLE (f, cx, cy): no distortion, square pixels.
///
///   x = f u + cx,   y = f v + cy,   u = X / Z,   v = Y / Z.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/lens.h"
#include "core/cameras/perspective.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct SimplePinhole {
  static constexpr char kName[] = "SIMPLE_PINHOLE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return ProjectThroughLens<Perspective, RadialPolynomial<0>, 1>(params, point, xy, d_point,
                                                                   d_params);
  }
};

}  // namespace bundle
