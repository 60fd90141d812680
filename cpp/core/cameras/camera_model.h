#pragma once

/// What a camera model is.
///
/// A model maps a point P = (X, Y, Z) in the frame of the camera (x right, y down, z forward, any
/// length unit) to pixels, given its parameters in COLMAP's order. Each model is one struct in one
/// header, with its derivation above it, that offers
///
///   static constexpr char kName[];                  COLMAP's name
///   static constexpr CameraParam kParams[];         name and kind of each parameter
///   static Projection Project(const double* params, const double* point, double* xy,
///                             double* d_point, double* d_params);
///
/// where d_point (2x3) and d_params (2 x number of parameters), both row-major, are filled with the
/// derivatives of xy unless they are nullptr. xy is the same to the last bit with and without
/// derivatives. Where a value has no derivative (a fold, a pole) the part without a limit counts as
/// zero. A model whose image is not a plane, so that two pixels far apart can be one direction,
/// also offers
///
///   static void Difference(const double* params, const double* xy, const double* measurement,
///                          double* residual);
///
/// where the residual is xy - measurement but for a piecewise constant. `registry.h` lists the
/// models; nothing else names them.

#include <type_traits>

namespace bundle {

enum class Projection {
  kValid,
  /// The point is where the lens cannot see it, yet the formula has a value, which is given.
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

inline constexpr int kMaxCameraParams = 16;

/// A model as data: what the run time knows of one of the structs described above.
struct CameraModel {
  const char* name;
  const CameraParam* params;
  int num_params;
  Projection (*project)(const double* params, const double* point, double* xy, double* d_point,
                        double* d_params);
  void (*difference)(const double* params, const double* xy, const double* measurement,
                     double* residual);
};

namespace internal {

template <typename Model, typename = void>
struct HasDifference : std::false_type {};
template <typename Model>
struct HasDifference<Model, std::void_t<decltype(&Model::Difference)>> : std::true_type {};

}  // namespace internal

/// The residual of a projection: Model::Difference if there is one, else xy - measurement.
template <typename Model>
void ModelDifference(const double* params, const double* xy, const double* measurement,
                     double* residual) {
  if constexpr (internal::HasDifference<Model>::value) {
    Model::Difference(params, xy, measurement, residual);
  } else {
    residual[0] = xy[0] - measurement[0];
    residual[1] = xy[1] - measurement[1];
  }
}

}  // namespace bundle
