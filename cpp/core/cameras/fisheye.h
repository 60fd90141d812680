#pragma once

/// SIMPLE_FISHEYE (f, cx, cy) and FISHEYE (fx, fy, cx, cy): the equidistant projection,
/// undistorted.
///
///   x = fx u + cx,   y = fy v + cy,   (u, v) = theta (X, Y) / r.
///
/// equidistant.h derives it.
///
/// Source: COLMAP, src/colmap/sensor/models.h.

#include "core/cameras/equidistant.h"
#include "core/cameras/lens.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct SimpleFisheye : Lens<Equidistant, RadialPolynomial<0>, 1> {
  static constexpr char kName[] = "SIMPLE_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

struct Fisheye : Lens<Equidistant, RadialPolynomial<0>, 2> {
  static constexpr char kName[] = "FISHEYE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

}  // namespace bundle
