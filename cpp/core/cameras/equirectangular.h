#pragma once

/// EQUIRECTANGULAR (w, h): the whole sphere around the camera, azimuth along x and elevation along
/// y.
///
/// With q = sqrt(X^2 + Z^2) and R^2 = q^2 + Y^2
///
///   x = w (atan2(X, Z) / (2 pi) + 1/2),   y = h (1/2 + atan2(Y, q) / pi),
///
/// so that the optical axis meets the centre of the image and the edges x = 0 and x = w, the seam,
/// are the same meridian behind the camera.
///
///   dx/d(X, Y, Z) = w / (2 pi) (Z, 0, -X) / q^2,
///   dy/d(X, Y, Z) = h / pi (-X Y / q, q, -Z Y / q) / R^2,
///   dx/dw = x / w,   dy/dh = y / h.
///
/// w and h are the size of the image: metadata, which no solve changes. At the poles, x is that of
/// azimuth 0, as in COLMAP; the derivatives w.r.t. X and Z do not exist and count as zero. Every
/// direction is valid. Points with |P| of about 2^-52 or less have no value.
///
/// Across the seam a residual is short although the pixels are far apart: `Difference` shifts it by
/// k turns to [-w/2, w/2). k is piecewise constant, but a turn is w pixels:
///
///   r_x = x - m_x - k w,   dr_x/dw = x / w - k.
///
/// Source: COLMAP, src/colmap/sensor/models.h, and
/// src/colmap/estimators/cost_functions/reprojection_error.h for the seam.

#include <cmath>
#include <limits>

#include "core/cameras/camera_model.h"

namespace bundle {

struct Equirectangular {
  static constexpr char kName[] = "EQUIRECTANGULAR";
  static constexpr CameraReach kReach = CameraReach::kAll;
  static constexpr CameraParam kParams[] = {{"w", CameraParam::kMetadata},
                                            {"h", CameraParam::kMetadata}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    constexpr double kPi = 3.14159265358979323846;
    constexpr double kMinNorm = std::numeric_limits<double>::epsilon();
    const double x = point[0], y = point[1], z = point[2];
    const double square = x * x + z * z;
    const double q = std::sqrt(square);
    if (!(q + std::abs(y) >= kMinNorm)) return Projection::kUndefined;
    const double turn = std::atan2(x, z) / (2 * kPi) + 0.5;
    const double drop = std::atan2(y, q) / kPi + 0.5;
    xy[0] = turn * params[0];
    xy[1] = drop * params[1];
    if (d_point != nullptr) {
      const double dx = square > 0 ? params[0] / (2 * kPi) / square : 0;
      const double dy = params[1] / kPi / (square + y * y);
      const double dy_dq = q > 0 ? -dy * y / q : 0;
      d_point[0] = dx * z, d_point[1] = 0, d_point[2] = -dx * x;
      d_point[3] = dy_dq * x, d_point[4] = dy * q, d_point[5] = dy_dq * z;
    }
    if (d_params != nullptr) {
      d_params[0] = turn, d_params[1] = 0;
      d_params[2] = 0, d_params[3] = drop;
    }
    return Projection::kValid;
  }

  static void Difference(const double* params, const double* xy, const double* measurement,
                         double* residual, double* d_params) {
    const double x = xy[0] - measurement[0];
    const double turns = std::floor(x / params[0] + 0.5);
    residual[0] = x - params[0] * turns;
    residual[1] = xy[1] - measurement[1];
    if (d_params != nullptr) d_params[0] -= turns;
  }
};

}  // namespace bundle
