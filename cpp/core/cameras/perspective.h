#pragma once

/// The perspective projection, and the models that distort it by an even polynomial or not at all.

#include <limits>

#include "core/cameras/camera_model.h"

namespace bundle {

/// d(s) and d'(s), by Horner's rule.
template <int n, typename T>
struct EvenPolynomial {
  T value = 1, slope = 0;

  EvenPolynomial(const T* k, T s) {
    if constexpr (n > 0) {
      value = k[n - 1];
      for (int j = n - 1; j >= 0; --j) {
        slope = value + s * slope;
        value = (j > 0 ? k[j - 1] : T(1)) + s * value;
      }
    }
  }
};

/// Even polynomial radial distortion, of any number n of coefficients.
///
/// With s = u^2 + v^2 and the factor d(s) = 1 + k1 s + ... + kn s^n
///
///   u_d = d u,   v_d = d v.
///
/// From ds/du = 2u, ds/dv = 2v and d' = k1 + 2 k2 s + ... + n kn s^(n-1)
///
///   du_d/du = d + 2 d' u^2,   du_d/dv = dv_d/du = 2 d' u v,   dv_d/dv = d + 2 d' v^2,
///   du_d/dkj = s^j u,   dv_d/dkj = s^j v.
template <int n>
struct RadialPolynomial {
  static constexpr int kNumParams = n;
  static constexpr bool kIsPolynomial = true;

  template <typename T>
  static bool Distort(const T* k, T u, T v, T* uv_d, T* d_uv, T* d_k) {
    const T s = u * u + v * v;
    const EvenPolynomial<n, T> d(k, s);
    uv_d[0] = d.value * u;
    uv_d[1] = d.value * v;
    if (d_uv != nullptr) {
      const T slope = 2 * d.slope;
      d_uv[0] = d.value + slope * u * u;
      d_uv[1] = d_uv[2] = slope * u * v;
      d_uv[3] = d.value + slope * v * v;
    }
    if (d_k != nullptr) {
      T power = 1;
      for (int j = 0; j < n; ++j) {
        power *= s;
        d_k[j] = power * u;
        d_k[n + j] = power * v;
      }
    }
    return true;
  }
};

/// No distortion at all.
template <>
struct RadialPolynomial<0> {
  static constexpr int kNumParams = 0;
  static constexpr bool kIsPolynomial = true;

  template <typename T>
  static bool Distort(const T*, T u, T v, T* uv_d, T* d_uv, T*) {
    uv_d[0] = u;
    uv_d[1] = v;
    if (d_uv != nullptr) d_uv[0] = d_uv[3] = 1, d_uv[1] = d_uv[2] = 0;
    return true;
  }
};

/// The perspective division shared by every model that starts with it.
///
///   u = X / Z, v = Y / Z,   du/dP = (1, 0, -u) / Z,   dv/dP = (0, 1, -v) / Z.
///
/// With J the 2x2 derivative of pixels w.r.t. (u, v), the chain rule gives, row by row,
///
///   dxy/dP = (J_u, J_v, -(J_u u + J_v v)) / Z.
///
/// |Z| below 2^-52 has no projection (COLMAP's threshold); negative Z is behind the camera, where
/// the formula still has a value.
struct Perspective {
  static constexpr CameraReach kReach = CameraReach::kFront;
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

  /// Computes one row of dxy/dP from the same row of dxy/d(u, v).
  void ChainRow(double d_u, double d_v, double* d_point_row) const {
    d_point_row[0] = d_u * inverse_z;
    d_point_row[1] = d_v * inverse_z;
    d_point_row[2] = -(d_u * u + d_v * v) * inverse_z;
  }
};

/// SIMPLE_PINHOLE (f, cx, cy): no distortion, square pixels.
///
///   x = f u + cx,   y = f v + cy,   u = X / Z,   v = Y / Z.
///
/// Source: COLMAP, src/colmap/sensor/models.h.
struct SimplePinhole : Lens<Perspective, RadialPolynomial<0>, 1> {
  static constexpr char kName[] = "SIMPLE_PINHOLE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

/// PINHOLE (fx, fy, cx, cy): no distortion.
///
///   x = fx u + cx,   y = fy v + cy,   u = X / Z,   v = Y / Z.
///
/// Source: COLMAP, src/colmap/sensor/models.h.
struct Pinhole : Lens<Perspective, RadialPolynomial<0>, 2> {
  static constexpr char kName[] = "PINHOLE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

/// SIMPLE_RADIAL (f, cx, cy, k) and RADIAL (f, cx, cy, k1, k2): even polynomial radial distortion,
/// derived at RadialPolynomial, of u = X / Z and v = Y / Z.
///
///   x = f d u + cx,   y = f d v + cy,   d = 1 + k1 s + k2 s^2,   s = u^2 + v^2.
///
/// A camera of Bundle Adjustment in the Large is RADIAL with cx = cy = 0 once its frame is turned
/// to look along +z and the image's y axis to point down.
///
/// Source: COLMAP, src/colmap/sensor/models.h.
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
