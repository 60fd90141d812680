#pragma once

/// Fisheye lenses: the equidistant projection, and the models that distort it by an even
/// polynomial.

#include <cmath>
#include <limits>

#include "core/cameras/camera_model.h"
#include "core/cameras/perspective.h"

namespace bundle {

/// A(q) = atan(t) / t as a function of q = t^2, and its derivative A' = dA/dq.
///
///   A' = (1 / (1 + q) - A) / (2 q).
///
/// The difference loses log10(1 / q) digits for small q, and both are 0 / 0 at q = 0. Below q =
/// 0.01 the series
///
///   A = sum_k (-q)^k / (2k + 1),        A' = -sum_k (-q)^k (k + 1) / (2k + 3)
///
/// has converged to the last bit after nine terms.
struct ArctanRatio {
  double value, slope;

  explicit ArctanRatio(double q) {
    if (q < 0.01) {
      constexpr int kLast = 8;
      value = 1.0 / (2 * kLast + 1);
      slope = (kLast + 1.0) / (2 * kLast + 3);
      for (int k = kLast - 1; k >= 0; --k) {
        value = 1.0 / (2 * k + 1) - q * value;
        slope = (k + 1.0) / (2 * k + 3) - q * slope;
      }
      slope = -slope;
    } else {
      const double t = std::sqrt(q);
      value = std::atan(t) / t;
      slope = (1 / (1 + q) - value) / (2 * q);
    }
  }
};

/// The equidistant projection shared by every fisheye model: the distance from the image's centre
/// is the angle to the optical axis.
///
/// With r = sqrt(X^2 + Y^2), R^2 = r^2 + Z^2 and theta = atan2(r, Z) in [0, pi]
///
///   u = a X,   v = a Y,   a = theta / r.
///
/// From dtheta/dr = Z / R^2 and dtheta/dZ = -r / R^2
///
///   da/dX = g X,   da/dY = g Y,   g = (Z / R^2 - a) / r^2,       da/dZ = -1 / R^2,
///
/// so that a row (J_u, J_v) of the derivative w.r.t. (u, v) gives, with e = J_u X + J_v Y, the row
///
///   dxy/dP = (a J_u + g e X,  a J_v + g e Y,  -e / R^2).
///
/// At 90 degrees the terms of the first two entries cancel along the radius; what remains there is
/// c = a + g r^2 = Z / R^2. With e' = J_u Y - J_v X, these two entries become
///
///   a J_u + g e X = c J_u - g e' Y,   a J_v + g e Y = c J_v + g e' X.
///
/// Up to 45 degrees from the axis, ArctanRatio gives a and g; it is accurate on the axis, too: with
/// q = (r / Z)^2, a = A(q) / Z and g = 2 A'(q) / Z^3. Farther out nothing cancels.
///
/// As in COLMAP, the camera sees points with Z >= 2^-52. The formula continues smoothly through 90
/// degrees (kBeyond) and ends on the axis behind the camera, where the direction of the image point
/// is undefined.
///
/// Source: COLMAP, src/colmap/sensor/models.h, FisheyeFromNormal (which has atan(r / Z)).
struct Equidistant {
  static constexpr CameraReach kReach = CameraReach::kAll;
  double u = 0, v = 0;
  Projection status = Projection::kUndefined;

  explicit Equidistant(const double* point) : x_(point[0]), y_(point[1]) {
    constexpr double kMinDepth = std::numeric_limits<double>::epsilon();
    const double z = point[2];
    const double square = x_ * x_ + y_ * y_;
    const double norm = square + z * z;
    if (z >= kMinDepth) {
      status = Projection::kValid;
    } else if (square > 0 && norm >= kMinDepth * kMinDepth) {
      status = Projection::kBeyond;
    } else {  // also when a coordinate is not a number
      return;
    }
    inverse_norm_ = 1 / norm;
    along_ = z * inverse_norm_;
    double scale;
    if (z > 0 && square <= z * z) {
      const double inverse_z = 1 / z;
      const ArctanRatio ratio(square * inverse_z * inverse_z);
      scale = ratio.value * inverse_z;
      slope_ = 2 * ratio.slope * inverse_z * inverse_z * inverse_z;
    } else {
      const double r = std::sqrt(square);
      scale = std::atan2(r, z) / r;
      slope_ = (along_ - scale) / square;
    }
    u = scale * x_;
    v = scale * y_;
  }

  /// Computes one row of dxy/dP from the same row of dxy/d(u, v).
  void ChainRow(double d_u, double d_v, double* d_point_row) const {
    const double across = slope_ * (d_u * y_ - d_v * x_);
    d_point_row[0] = along_ * d_u - across * y_;
    d_point_row[1] = along_ * d_v + across * x_;
    d_point_row[2] = -(d_u * x_ + d_v * y_) * inverse_norm_;
  }

 private:
  double x_, y_;
  double along_ = 0;         // c
  double slope_ = 0;         // g
  double inverse_norm_ = 0;  // 1 / R^2
};

/// SIMPLE_FISHEYE (f, cx, cy) and FISHEYE (fx, fy, cx, cy): the equidistant projection,
/// undistorted.
///
///   x = fx u + cx,   y = fy v + cy,   (u, v) = theta (X, Y) / r.
///
/// Equidistant derives it.
///
/// Source: COLMAP, src/colmap/sensor/models.h.
struct SimpleFisheye : Lens<Equidistant, RadialPolynomial<0>, 1> {
  static constexpr char kName[] = "SIMPLE_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

struct Fisheye : Lens<Equidistant, RadialPolynomial<0>, 2> {
  static constexpr char kName[] = "FISHEYE";
  static constexpr CameraParam kParams[] = {{"fx", CameraParam::kFocal},
                                            {"fy", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint}};
};

/// SIMPLE_RADIAL_FISHEYE (f, cx, cy, k), RADIAL_FISHEYE (f, cx, cy, k1, k2) and OPENCV_FISHEYE (fx,
/// fy, cx, cy, k1, k2, k3, k4): an even polynomial of the angle to the optical axis.
///
///   x = fx d u + cx,   y = fy d v + cy,   d = 1 + k1 theta^2 + k2 theta^4 + ...,
///
/// with (u, v) = theta (X, Y) / r of Equidistant, hence u^2 + v^2 = theta^2, and d as in
/// RadialPolynomial.
///
/// Source: COLMAP, src/colmap/sensor/models.h; Kannala and Brandt, PAMI 2006; for OPENCV_FISHEYE
/// also OpenCV, calib3d, fisheye::projectPoints.
struct SimpleRadialFisheye : Lens<Equidistant, RadialPolynomial<1>, 1> {
  static constexpr char kName[] = "SIMPLE_RADIAL_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k", CameraParam::kExtra}};
};

struct RadialFisheye : Lens<Equidistant, RadialPolynomial<2>, 1> {
  static constexpr char kName[] = "RADIAL_FISHEYE";
  static constexpr CameraParam kParams[] = {{"f", CameraParam::kFocal},
                                            {"cx", CameraParam::kPrincipalPoint},
                                            {"cy", CameraParam::kPrincipalPoint},
                                            {"k1", CameraParam::kExtra},
                                            {"k2", CameraParam::kExtra}};
};

struct OpenCvFisheye : Lens<Equidistant, RadialPolynomial<4>, 2> {
  static constexpr char kName[] = "OPENCV_FISHEYE";
  static constexpr CameraParam kParams[] = {
      {"fx", CameraParam::kFocal},          {"fy", CameraParam::kFocal},
      {"cx", CameraParam::kPrincipalPoint}, {"cy", CameraParam::kPrincipalPoint},
      {"k1", CameraParam::kExtra},          {"k2", CameraParam::kExtra},
      {"k3", CameraParam::kExtra},          {"k4", CameraParam::kExtra}};
};

}  // namespace bundle
