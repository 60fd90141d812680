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
/// derivatives. `registry.h` lists the models; nothing else names them.

namespace bundle {

enum class Projection {
  kValid,
  /// The point is where the lens cannot see it, yet the formula has a value, which is given.
  kBehind,
  /// The formula has no value; outputs are untouched.
  kUndefined,
};

struct CameraParam {
  enum Kind { kFocal, kPrincipalPoint, kExtra };
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
};

}  // namespace bundle
