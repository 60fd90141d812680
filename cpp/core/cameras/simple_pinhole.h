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

struct SimplePinhole : Lens<Perspective, RadialPolynomial<0>, 1> {
  static constexpr char kName[] = "SIMPLE_PINHOLE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

}  // namespace bundle
