#pragma once

/// The perspective division shared by every model that starts with it.
///
///   u = X / Z, v = Y / Z,   du/dP = (1, 0, -u) / Z,   dv/dP = (0, 1, -v) / Z.
///
/// With J the 2x2 derivative of pixels by (u, v), the chain rule gives, row by row,
///
///   dxy/dP = (J_u, J_v, -(J_u u + J_v v)) / Z.
///
/// |Z| below 2^-52 has no projection (COLMAP's threshold); negative Z is behind the camera, where
/// the formula still has a value.

#include <limits>

#include "core/cameras/camera_model.h"

namespace bundle {

struct Perspective {
  double u, v, inverse_z;
  Projection status;

  explicit Perspective(const double* point) {
    const double z = point[2];
    constexpr double kMinDepth = std::numeric_limits<double>::epsilon();
    if (z >= kMinDepth) {
      status = Projection::kValid;
    } else if (z <= -kMinDepth) {
      status = Projection::kBehind;
    } else {  // also when z is not a number
      status = Projection::kUndefined;
      u = v = inverse_z = 0;
      return;
    }
    inverse_z = 1 / z;
    u = point[0] * inverse_z;
    v = point[1] * inverse_z;
  }

  /// One row of dxy/dP out of the same row of dxy/d(u, v).
  void ChainRow(double d_u, double d_v, double* d_point_row) const {
    d_point_row[0] = d_u * inverse_z;
    d_point_row[1] = d_v * inverse_z;
    d_point_row[2] = -(d_u * u + d_v * v) * inverse_z;
  }
};

}  // namespace bundle
