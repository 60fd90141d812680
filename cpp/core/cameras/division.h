#pragma once

/// SIMPLE_DIVISION (f, cx, cy, k) and DIVISION (fx, fy, cx, cy, k): the one-parameter division
/// model.
///
/// The undistorted ray of the image point (u, v) is (u, v, 1 + k (u^2 + v^2)). With rho^2 = X^2 +
/// Y^2 the point P is on the ray of (u, v) = g (X, Y) where g solves
///
///   k rho^2 g^2 - Z g + 1 = 0,   g = 2 / (Z + D),   D = sqrt(Z^2 - 4 k rho^2),
///   x = fx g X + cx,   y = fy g Y + cy.
///
/// For Z < 0 the sum cancels and the same root is taken as g = (Z - D) / (2 k rho^2).
/// Differentiating the equation, whose derivative with respect to g is -D,
///
///   dg/dX = 2 k g^2 X / D,   dg/dY = 2 k g^2 Y / D,   dg/dZ = -g / D,   dg/dk = g^2 rho^2 / D.
///
/// For k > 0 the model folds where D = 0; beyond it there is no value. On the fold itself g has a
/// value and no derivative, and counts as constant. For k < 0 the lens sees more than 180 degrees.
///
/// Every value is valid, as in COLMAP, which does not test Z here. Behind the camera, for k > 0, g
/// is negative and the value is that of the mirrored ray.
///
/// Source: COLMAP, src/colmap/sensor/models.h; Fitzgibbon, CVPR 2001.

#include <algorithm>
#include <cmath>

#include "core/cameras/camera_model.h"

namespace bundle {

namespace internal {

template <int kNumFocal>
Projection ProjectDivision(const double* params, const double* point, double* xy, double* d_point,
                           double* d_params) {
  constexpr int kNumParams = kNumFocal + 3;
  const double focal[2] = {params[0], params[kNumFocal - 1]};
  const double k = params[kNumParams - 1];
  const double z = point[2];
  const double square = point[0] * point[0] + point[1] * point[1];
  const double discriminant = z * z - 4 * k * square;
  if (!(discriminant >= 0)) return Projection::kUndefined;
  const double root = std::sqrt(discriminant);
  const double g = z < 0 ? (z - root) / (2 * k * square) : 2 / (z + root);
  const double uv[2] = {g * point[0], g * point[1]};
  const double values[2] = {focal[0] * uv[0] + params[kNumFocal],
                            focal[1] * uv[1] + params[kNumFocal + 1]};
  if (!std::isfinite(values[0]) || !std::isfinite(values[1])) return Projection::kUndefined;
  xy[0] = values[0], xy[1] = values[1];
  const double inverse_root = root > 0 ? 1 / root : 0;
  if (d_point != nullptr) {
    const double bend = 2 * k * g * g * inverse_root;
    for (int row = 0; row < 2; ++row) {
      double* out = d_point + 3 * row;
      for (int j = 0; j < 2; ++j) {
        out[j] = focal[row] * (bend * point[j] * point[row] + (j == row ? g : 0));
      }
      out[2] = -focal[row] * uv[row] * inverse_root;
    }
  }
  if (d_params != nullptr) {
    for (int row = 0; row < 2; ++row) {
      double* out = d_params + kNumParams * row;
      std::fill_n(out, kNumParams, 0.0);
      out[kNumFocal == 1 ? 0 : row] = uv[row];
      out[kNumFocal + row] = 1;
      out[kNumParams - 1] = focal[row] * uv[row] * g * square * inverse_root;
    }
  }
  return Projection::kValid;
}

}  // namespace internal

struct SimpleDivision {
  static constexpr char kName[] = "SIMPLE_DIVISION";
  static constexpr CameraReach kReach = CameraReach::kAll;
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return internal::ProjectDivision<1>(params, point, xy, d_point, d_params);
  }
};

struct Division {
  static constexpr char kName[] = "DIVISION";
  static constexpr CameraReach kReach = CameraReach::kAll;
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    return internal::ProjectDivision<2>(params, point, xy, d_point, d_params);
  }
};

}  // namespace bundle
