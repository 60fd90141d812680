#pragma once

/// SIMPLE_RADIAL_FISHEYE (f, cx, cy, k), RADIAL_FISHEYE (f, cx, cy, k1, k2) and OPENCV_FISHEYE (fx,
/// fy, cx, cy, k1, k2, k3, k4): an even polynomial of the angle to the optical axis.
///
///   x = fx d u + cx,   y = fy d v + cy,   d = 1 + k1 theta^2 + k2 theta^4 + ...,
///
/// with (u, v) = theta (X, Y) / r out of equidistant.h, hence u^2 + v^2 = theta^2, and d out of
/// radial_polynomial.h.
///
/// Source: COLMAP, src/colmap/sensor/models.h; Kannala and Brandt, PAMI 2006; for OPENCV_FISHEYE
/// also OpenCV, calib3d, fisheye::projectPoints.

#include "core/cameras/equidistant.h"
#include "core/cameras/lens.h"
#include "core/cameras/radial_polynomial.h"

namespace bundle {

struct SimpleRadialFisheye : Lens<Equidistant, RadialPolynomial<1>, 1> {
  static constexpr char kName[] = "SIMPLE_RADIAL_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};
};

struct RadialFisheye : Lens<Equidistant, RadialPolynomial<2>, 1> {
  static constexpr char kName[] = "RADIAL_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k1", CameraParam::kExtra},
                                            {"k2", CameraParam::kExtra}};
};

struct OpenCvFisheye : Lens<Equidistant, RadialPolynomial<4>, 2> {
  static constexpr char kName[] = "OPENCV_FISHEYE";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"k3", CameraParam::kExtra},          {"k4", CameraParam::kExtra}};
};

}  // namespace bundle
