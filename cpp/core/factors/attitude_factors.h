#pragma once

/// Factors of an image's attitude: the direction of a known axis of the world, the whole rotation,
/// and the heading. Their variable is the pose cam_from_world (R, t) on SE(3), of which they see R.
///
/// With right perturbations R Exp(d), a vector w of the world is at p = R w in the camera, and a
/// vector a of the camera at y = R^T a in the world, with
///
///   dp/dd = -R [w]x = -[p]x R,        dy/dd = [y]x.

#include <vector>

#include "core/factors/factor.h"
#include "core/geometry/retraction.h"

namespace bundle {

/// A measured direction m of the axis w of the world in the camera's frame, such as gravity's.
///
/// The residual is the chord on the unit sphere from m to p = R w, for unit vectors,
///
///   r = (p - m) / sigma,        J = -[p]x R / sigma,
///
/// whose length is 2 sin(x/2) / sigma with x the angle between them: x / sigma for small angles.
/// Its cost (1 - cos x) / sigma^2 is the negative logarithm of the von Mises-Fisher density of
/// concentration 1 / sigma^2, the normal distribution on the sphere (Mardia and Jupp, "Directional
/// statistics", 2000, section 9.3.2).
///
/// It is smooth and J^T J = R^T (I - p p^T) R / sigma^2 is bounded at every angle, up to 180
/// degrees (a logarithm in the tangent plane of m has (x / sin x)^2 / sigma^2 across, which grows
/// without bound near 180 degrees and holds the world instead of turning it). The pull sin(x) /
/// sigma^2 of a direction that is upside down vanishes. Turns about w do not change r: J has rank 2
/// with the null direction d = w, for any residual. Two of its three numbers are independent; the
/// third is of second order at small angles.
class DirectionFactor final : public Factor {
 public:
  /// `direction` is m in the camera's frame, `axis` is w; both of any length above 0. `sigma` in
  /// radians, about each axis perpendicular to m. Throws InputError if they are not.
  DirectionFactor(FactorHead head, std::vector<double> direction, std::vector<double> axis,
                  double sigma);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;
  /// Two, as the residual has no component along the direction.
  int num_measurements() const override { return 2; }

 private:
  std::vector<double> direction_;
  std::vector<double> axis_;
  double sigma_;
};

/// A measured rotation Z of cam_from_world: r = W Log(Z^T R).
///
/// The logarithm is a rotation vector along the axes of the world, in radians: the information W^T
/// W belongs to these axes (for east, north, up, the third is the heading's). As for PriorFactor, J
/// = W J_r(e)^-1 by the rotation and zero by the translation.
class RotationFactor final : public Factor {
 public:
  /// `rotation` is a quaternion qx qy qz qw. Throws InputError if it is zero or the information (3
  /// x 3) is not positive definite.
  RotationFactor(FactorHead head, std::vector<double> rotation, std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> rotation_;
  Whitening whitening_;
};

/// A measured heading h of an axis a of the camera: r = wrap(atan2(y_1, y_2) - h) / sigma.
///
/// y = R^T a in a world whose axes are east, north, up; the heading is clockwise from north. By the
/// rule above dy_1 = y_2 d_3 - y_3 d_2 and dy_2 = y_3 d_1 - y_1 d_3, so that
///
///   dr/dd = (-y_3 y_1 / h^2, -y_3 y_2 / h^2, 1) / sigma,        h^2 = y_1^2 + y_2^2.
///
/// An exactly vertical axis has no heading, and the factor no value.
class HeadingFactor final : public Factor {
 public:
  /// `heading` and `sigma` in radians. Throws InputError if the axis is zero or sigma not above 0.
  HeadingFactor(FactorHead head, std::vector<double> axis, double heading, double sigma);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> axis_;
  double heading_;
  double sigma_;
};

}  // namespace bundle
