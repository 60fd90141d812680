#pragma once

/// Camera models.
///
/// A model maps a point P = (X, Y, Z) in the frame of the camera (x right, y down, z forward, any
/// length unit) to pixels, given its parameters in COLMAP's order. Each model is one struct in one
/// header, with its derivation above it, that offers
///
///   static constexpr char kName[];                  COLMAP's name
///   static constexpr CameraParam kParams[];         name and kind of each parameter
///   static constexpr CameraReach kReach;            how far its formula goes
///   static Projection Project(const double* params, const double* point, double* xy,
///                             double* d_point, double* d_params);
///
/// where d_point (2x3) and d_params (2 x number of parameters), both row-major, are filled with the
/// derivatives of xy unless they are nullptr. xy is the same to the last bit with and without
/// derivatives. At a fold or a pole, derivatives that do not exist are zero. If the image of a
/// model is not a plane, two distant pixels can have the same direction. Such a model also offers
///
///   static void Difference(const double* params, const double* xy, const double* measurement,
///                          double* residual, double* d_params);
///
/// whose residual is xy - measurement plus a function of the parameters that is constant in xy,
/// piecewise. d_params, unless nullptr, has the derivatives of xy w.r.t. the parameters and becomes
/// that of the residual. `registry.h` lists the models; nothing else names them.

#include <type_traits>

namespace bundle {

enum class Projection {
  kValid,
  /// The point is beyond 90 degrees from the optical axis, where the formula of a wide lens
  /// continues smoothly; its value is given.
  kBeyond,
  /// The lens cannot see the point, but the formula has a value; this value is given.
  kBehind,
  /// The formula has no value; outputs are untouched.
  kUndefined,
};

struct CameraParam {
  enum Kind {
    kFocal,  ///< positive
    kPrincipalPoint,
    kExtra,
    kMetadata,  ///< not a parameter of the lens: positive, and never refined
  };
  const char* name;
  Kind kind;
};

/// The angle from the optical axis up to which a formula has no discontinuity.
enum class CameraReach {
  kFront,   ///< to less than 90 degrees: nothing is kBeyond
  kBeyond,  ///< farther, to where it breaks: elsewhere points are kBehind
  kAll,     ///< to everything that has a value: nothing is kBehind
};

inline constexpr int kMaxCameraParams = 16;

/// A model as data, made from one of the structs described above.
struct CameraModel {
  const char* name;
  const CameraParam* params;
  int num_params;
  CameraReach reach;
  Projection (*project)(const double* params, const double* point, double* xy, double* d_point,
                        double* d_params);
  void (*difference)(const double* params, const double* xy, const double* measurement,
                     double* residual, double* d_params);
};

namespace internal {

template <typename Model, typename = void>
struct HasDifference : std::false_type {};
template <typename Model>
struct HasDifference<Model, std::void_t<decltype(&Model::Difference)>> : std::true_type {};

}  // namespace internal

/// The residual of a projection: Model::Difference if there is one, else xy - measurement.
/// `d_params`: as there.
template <typename Model>
void ModelDifference(const double* params, const double* xy, const double* measurement,
                     double* residual, [[maybe_unused]] double* d_params) {
  if constexpr (internal::HasDifference<Model>::value) {
    Model::Difference(params, xy, measurement, residual, d_params);
  } else {
    residual[0] = xy[0] - measurement[0];
    residual[1] = xy[1] - measurement[1];
  }
}

/// Composition of most models: rays, then a distortion, then pixels.
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
/// kNumParams), row-major; false if it has no value. A polynomial distortion has a value
/// everywhere. Its Distort is a template of the number type, so that it can process several
/// observations at once. Parameters are, in COLMAP's order, one or two focal lengths, the principal
/// point, then k. By the chain rule, with F = diag(fx, fy),
///
///   dxy/dP = F d(u_d, v_d)/d(u, v) d(u, v)/dP,    dxy/dk = F d(u_d, v_d)/dk,
///   dx/dfx = u_d,   dy/dfy = v_d   (both in one column for a single f),   dx/dcx = dy/dcy = 1.
template <typename LensRays, typename LensDistortion, int kNumFocal>
struct Lens {
  using Rays = LensRays;
  using Distortion = LensDistortion;
  static constexpr int kExtra = kNumFocal + 2;  ///< index of the first of k
  static constexpr int kNumLensParams = kExtra + Distortion::kNumParams;
  static constexpr CameraReach kReach = Rays::kReach;

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
