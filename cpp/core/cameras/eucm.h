#pragma once

/// EUCM (fx, fy, cx, cy, alpha, beta): the enhanced unified camera model.
///
/// With R = sqrt(beta (X^2 + Y^2) + Z^2) and the denominator m = alpha R + (1 - alpha) Z
///
///   x = fx X / m + cx,   y = fy Y / m + cy.
///
/// From dR/dX = beta X / R, dR/dZ = Z / R and dR/dbeta = (X^2 + Y^2) / (2 R), with a = alpha / R
/// and b = alpha beta / R,
///
///   dm/d(X, Y, Z) = (b X, b Y, a Z + 1 - alpha),   dm/dalpha = R - Z,   dm/dbeta = a (X^2 + Y^2) /
///   2, d(X / m)/dX = (m - b X^2) / m^2,   d(X / m)/dq = -X / m^2 dm/dq for any other q.
///
/// Two of these lose digits by cancellation, at the edge of the field of view and on the axis. They
/// are computed without it:
///
///   m - b X^2 = b Y^2 + (a Z + 1 - alpha) Z,   R - Z = beta (X^2 + Y^2) / (R + Z)    (Z > 0).
///
/// As in COLMAP, the camera sees points with Z >= 2^-52 and m >= 2^-52. For smaller Z the formula
/// continues smoothly up to m = 0 (kBeyond). Elsewhere it gives the value of the mirrored ray,
/// unless beta is so negative that R has no value, or |m| < 2^-52. At R = 0, the derivative of m by
/// R does not exist and counts as zero.
///
/// Source: COLMAP, src/colmap/sensor/models.h; Khomutenko, Garcia and Martinet, RA-L 2016.

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/cameras/camera_model.h"

namespace bundle {

struct Eucm {
  static constexpr char kName[] = "EUCM";
  static constexpr CameraReach kReach = CameraReach::kBeyond;
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"alpha", CameraParam::kExtra},       {"beta", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    constexpr double kMinDepth = std::numeric_limits<double>::epsilon();
    const double x = point[0], y = point[1], z = point[2];
    const double alpha = params[4], beta = params[5];
    const double square = x * x + y * y;
    const double radicand = beta * square + z * z;
    if (!(radicand >= 0)) return Projection::kUndefined;
    const double r = std::sqrt(radicand);
    const double m = alpha * r + (1 - alpha) * z;
    if (!(std::abs(m) >= kMinDepth)) return Projection::kUndefined;
    const double inverse_m = 1 / m;
    const double u = x * inverse_m, v = y * inverse_m;
    xy[0] = params[0] * u + params[2];
    xy[1] = params[1] * v + params[3];
    const double a = r > 0 ? alpha / r : 0, b = beta * a;
    if (d_point != nullptr) {
      const double dm_dz = a * z + 1 - alpha;
      const double fx = params[0] * inverse_m, fy = params[1] * inverse_m;
      d_point[0] = fx * (b * y * y + dm_dz * z) * inverse_m;
      d_point[1] = -fx * u * b * y;
      d_point[2] = -fx * u * dm_dz;
      d_point[3] = -fy * v * b * x;
      d_point[4] = fy * (b * x * x + dm_dz * z) * inverse_m;
      d_point[5] = -fy * v * dm_dz;
    }
    if (d_params != nullptr) {
      const double dm_dalpha = z > 0 ? beta * square / (r + z) : r - z;
      const double dm_dbeta = a * square / 2;
      const double fu = -params[0] * u * inverse_m, fv = -params[1] * v * inverse_m;
      const double row_x[] = {u, 0, 1, 0, fu * dm_dalpha, fu * dm_dbeta};
      const double row_y[] = {0, v, 0, 1, fv * dm_dalpha, fv * dm_dbeta};
      std::copy_n(row_x, 6, d_params);
      std::copy_n(row_y, 6, d_params + 6);
    }
    if (m < 0) return Projection::kBehind;
    return z >= kMinDepth ? Projection::kValid : Projection::kBeyond;
  }
};

}  // namespace bundle
