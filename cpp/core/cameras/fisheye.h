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

struct SimpleFisheye {
  static constexpr char kName[] = "SIMPLE_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return ProjectThroughLens<Equidistant, RadialPolynomial<0>, 1>(params, point, xy, d_point,
                                                                   d_params);
  }
};

struct Fisheye {
  static constexpr char kName[] = "FISHEYE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return ProjectThroughLens<Equidistant, RadialPolynomial<0>, 2>(params, point, xy, d_point,
                                                                   d_params);
  }
};

}  // namespace bundle
