#pragma once

/// How most models are put together: rays, then a distortion, then pixels.
///
///   (u, v) = Rays(P),    (u_d, v_d) = Distortion(k; u, v),    x = fx u_d + cx,   y = fy v_d + cy.
///
/// `Rays` is Perspective or Equidistant. `Distortion` is a struct with
///
///   static constexpr int kNumParams;
///   static constexpr bool kIsPolynomial;
///   static bool Distort(const double* k, double u, double v, double* uv_d, double* d_uv,
///                       double* d_k);
///
/// which fills uv_d and, unless they are nullptr, its derivatives d_uv (2x2) and d_k (2 x
/// kNumParams), row-major; false if it has no value. One that is a polynomial has a value
/// everywhere, and Distort is a template of the number type, so that several observations can go
/// through it at once. Parameters are, in COLMAP's order, one or two focal lengths, the principal
/// point, then k. By the chain rule, with F = diag(fx, fy),
///
///   dxy/dP = F d(u_d, v_d)/d(u, v) d(u, v)/dP,    dxy/dk = F d(u_d, v_d)/dk,
///   dx/dfx = u_d,   dy/dfy = v_d   (both in one column for a single f),   dx/dcx = dy/dcy = 1.

#include "core/cameras/camera_model.h"

namespace bundle {

template <typename LensRays, typename LensDistortion, int kNumFocal>
struct Lens {
  using Rays = LensRays;
  using Distortion = LensDistortion;
  static constexpr int kExtra = kNumFocal + 2;  ///< index of the first of k
  static constexpr int kNumLensParams = kExtra + Distortion::kNumParams;

  static Projection Project(const double* params, const double* point, double* xy, double* d_point,
                            double* d_params) {
    const Rays rays(point);
    if (rays.status == Projection::kUndefined) return rays.status;
    double uv[2], d_uv[4], d_k[2 * Distortion::kNumParams + 1];
    if (!Distortion::Distort(params + kExtra, rays.u, rays.v, uv,
                             d_point != nullptr ? d_uv : nullptr,
                             d_params != nullptr ? d_k : nullptr)) {
      return Projection::kUndefined;
    }
    ToPixels(params, uv, xy);
    if (d_point != nullptr) ChainPoint(params, rays, d_uv, d_point);
    if (d_params != nullptr) ChainParams(params, uv, d_k, d_params);
    return rays.status;
  }

  template <typename T>
  static void ToPixels(const T* params, const T* uv, T* xy) {
    for (int row = 0; row < 2; ++row)
      xy[row] = Focal(params, row) * uv[row] + params[kExtra - 2 + row];
  }

  template <typename T, typename RaysOfT>
  static void ChainPoint(const T* params, const RaysOfT& rays, const T* d_uv, T* d_point) {
    for (int row = 0; row < 2; ++row) {
      const T focal = Focal(params, row);
      rays.ChainRow(focal * d_uv[2 * row], focal * d_uv[2 * row + 1], d_point + 3 * row);
    }
  }

  template <typename T>
  static void ChainParams(const T* params, const T* uv, const T* d_k, T* d_params) {
    for (int row = 0; row < 2; ++row) {
      T* out = d_params + row * kNumLensParams;
      for (int j = 0; j < kExtra; ++j) out[j] = T(0);
      out[kNumFocal == 1 ? 0 : row] = uv[row];
      out[kExtra - 2 + row] = T(1);
      for (int j = 0; j < Distortion::kNumParams; ++j) {
        out[kExtra + j] = Focal(params, row) * d_k[row * Distortion::kNumParams + j];
      }
    }
  }

 private:
  template <typename T>
  static T Focal(const T* params, int row) {
    return params[kNumFocal == 1 ? 0 : row];
  }
};

}  // namespace bundle
