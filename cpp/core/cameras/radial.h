#pragma once

/// SIMPLE_RADIAL (f, cx, cy, k) and RADIAL (f, cx, cy, k1, k2): even polynomial radial distortion,
/// derived in radial_polynomial.h, of u = X / Z and v = Y / Z.
///
///   x = f d u + cx,   y = f d v + cy,   d = 1 + k1 s + k2 s^2,   s = u^2 + v^2.
///
/// A camera of Bundle Adjustment in the Large is RADIAL with cx = cy = 0 once its frame is turned
/// to look along +z and the image's y axis to point down.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/lens.h"
#include "core/cameras/perspective.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct SimpleRadial : Lens<Perspective, RadialPolynomial<1>, 1> {
  static constexpr char kName[] = "SIMPLE_RADIAL";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};
};

struct Radial : Lens<Perspective, RadialPolynomial<2>, 1> {
  static constexpr char kName[] = "RADIAL";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k1", CameraParam::kExtra},
                                            {"k2", CameraParam::kExtra}};
};

}  // namespace bundle
