#pragma once

/// How most models are put together: rays, then a distortion, then pixels.
///
///   (u, v) = Rays(P),    (u_d, v_d) = Distortion(k; u, v),    x = fx u_d + cx,   y = fy v_d + cy.
///
/// `Rays` is Perspective or Equidistant. `Distortion` is a struct with
///
///   static constexpr int kNumParams;
///   static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
///                       double* d_k);
///
/// which fills uv_d and, unless they are nullptr, its derivatives d_uv (2x2) and d_k (2 x
/// kNumParams), row-major; false if it has no value. Parameters are, in COLMAP's order, one or two
/// focal lengths, the principal point, then k. By the chain rule, with F = diag(fx, fy),
///
///   dxy/dP = F d(u_d, v_d)/d(u, v) d(u, v)/dP,    dxy/dk = F d(u_d, v_d)/dk,
///   dx/dfx = u_d,   dy/dfy = v_d   (both in one column for a single f),   dx/dcx = dy/dcy = 1.

#include <algorithm>

#include "core/cameras/camera_model.h"

namespace bundle {

template <typename Rays, typename Distortion, int kNumFocal>
Projection ProjectThroughLens(const double* params, const double* point, double* xy,
                              double* d_point, double* d_params) {
  constexpr int kNumExtra = Distortion::kNumParams;
  constexpr int kExtra = kNumFocal + 2;
  constexpr int kNumParams = kExtra + kNumExtra;
  const double focal[2] = {params[0], params[kNumFocal - 1]};
  const Rays rays(point);
  if (rays.status == Projection::kUndefined) return rays.status;
  double uv[2], d_uv[4], d_k[2 * kNumExtra + 1];
  if (!Distortion::Distort(params + kExtra, rays.u, rays.v, uv, d_point != nullptr ? d_uv : nullptr,
                           d_params != nullptr ? d_k : nullptr)) {
    return Projection::kUndefined;
  }
  for (int row = 0; row < 2; ++row) xy[row] = focal[row] * uv[row] + params[kNumFocal + row];
  if (d_point != nullptr) {
    rays.ChainRow(focal[0] * d_uv[0], focal[0] * d_uv[1], d_point);
    rays.ChainRow(focal[1] * d_uv[2], focal[1] * d_uv[3], d_point + 3);
  }
  if (d_params != nullptr) {
    for (int row = 0; row < 2; ++row) {
      double* out = d_params + row * kNumParams;
      std::fill_n(out, kExtra, 0.0);
      out[kNumFocal == 1 ? 0 : row] = uv[row];
      out[kNumFocal + row] = 1;
      for (int j = 0; j < kNumExtra; ++j) out[kExtra + j] = focal[row] * d_k[row * kNumExtra + j];
    }
  }
  return rays.status;
}

}  // namespace bundle
