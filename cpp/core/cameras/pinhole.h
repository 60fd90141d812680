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

struct Pinhole : Lens<Perspective, RadialPolynomial<0>, 2> {
  static constexpr char kName[] = "PINHOLE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

}  // namespace bundle
