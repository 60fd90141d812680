#pragma once

/// The residual of a landmark given by its position in its anchoring image and its inverse depth
/// there: three numbers (x, y, l).
///
/// In image h it is at m = (x, y, 1), normalised, with l = 1 / z. The observation in this image is
/// a measurement of x and y like any other. Often it is taken as exact, to have one number per
/// landmark. Its noise is then in all residuals of the landmark, but least squares assumes that
/// these are independent. Such an estimator is several times too certain.
///
///  With camera_from_imu (C, c) and the
/// poses world_from_imu (R_h, p_h), (R_j, p_j) of both images, its point in camera j, times l, is
///
///   a = C^T (m - l c)                     in the IMU of h
///   b = R_j^T (R_h a + l (p_h - p_j))     in the IMU of j
///   y = C b + l c                         in camera j,
///
/// homogeneous: l = 0 is a point at infinity, and no step divides by l. The residual is r = (y_x /
/// y_z - x_j, y_y / y_z - y_j) / sigma. Perturbing R_h, R_j and C on the right by Exp(d) and all
/// other variables by addition, with G = C R_j^T and [a]x the cross product matrix,
///
///   dy/d(R_h) = -G R_h [a]x        dy/d(p_h) = l G
///   dy/d(R_j) =  C [b]x            dy/d(p_j) = -l G
///   dy/d(C)   = -C [b]x + G R_h [a]x
///   dy/d(c)   = l (I - G R_h C^T)
///   dy/dl     = c + G (p_h - p_j - R_h C^T c)
///   dy/dm     = G R_h C^T, its first two columns by (x, y)
///
/// (a moves by [a]x d with C, since C^T becomes Exp(-d) C^T.) Both images were taken t seconds
/// after the instants of their states; t is the time offset beyond the one used to place the
/// states. At these instants the features were at (x, y) - t (u, v), with (u, v) the velocities of
/// the features, so that
///
///   dy/dt = -G R_h C^T (u_h, v_h, 0),     and r itself gains (u_j, v_j) / sigma
///
/// (T. Qin, S. Shen, Online temporal calibration for monocular visual-inertial systems, IROS 2018).

#include <cmath>

#include "core/geometry/rotation.h"
#include "core/inertial/imu_residual.h"

namespace bundle {

struct CameraOfImu {
  double rotation[9];  ///< camera_from_imu, row-major
  double translation[3];
};

/// Observations of a landmark by two images.
struct LandmarkSight {
  double anchor_velocity[2];
  double seen[2], velocity[2];
};

/// Row-major, 2 rows each.
struct DepthJacobians {
  double by_anchor[12], by_observer[12], by_camera[12], by_time[2], by_point[6];
};

/// The residual, in units of sigma, and if `jacobians` is given also these. False if the landmark
/// is not in front of camera j.
inline bool InverseDepthResidual(const ImuState& h, const ImuState& j, const CameraOfImu& camera,
                                 const double point[3], double time, const LandmarkSight& sight,
                                 double sigma, double residual[2], DepthJacobians* jacobians) {
  const double m[3] = {point[0] - time * sight.anchor_velocity[0],
                       point[1] - time * sight.anchor_velocity[1], 1};
  const double depth = point[2];
  double a[3], b[3], y[3], moved[3], turned[3];
  for (int k = 0; k < 3; ++k) moved[k] = m[k] - depth * camera.translation[k];
  VectorMatrix3(moved, camera.rotation, a);
  MatrixVector3(h.rotation, a, turned);
  for (int k = 0; k < 3; ++k) turned[k] += depth * (h.position[k] - j.position[k]);
  VectorMatrix3(turned, j.rotation, b);
  MatrixVector3(camera.rotation, b, y);
  for (int k = 0; k < 3; ++k) y[k] += depth * camera.translation[k];
  const double norm = std::abs(y[0]) + std::abs(y[1]) + std::abs(y[2]);
  if (!(y[2] > 1e-6 * norm)) return false;
  const double inverse = 1 / y[2], u = y[0] * inverse, v = y[1] * inverse, scale = 1 / sigma;
  residual[0] = scale * (u - sight.seen[0] + time * sight.velocity[0]);
  residual[1] = scale * (v - sight.seen[1] + time * sight.velocity[1]);
  if (jacobians == nullptr) return true;

  // Rows of d(residual)/dy and their products: with C, with G = C R_j^T, with G R_h, with G R_h
  // C^T.
  const double rows[2][3] = {{scale * inverse, 0, -scale * inverse * u},
                             {0, scale * inverse, -scale * inverse * v}};
  double baseline[3], offset[3];
  VectorMatrix3(camera.translation, camera.rotation, offset);
  MatrixVector3(h.rotation, offset, baseline);
  for (int k = 0; k < 3; ++k) baseline[k] = h.position[k] - j.position[k] - baseline[k];
  DepthJacobians& out = *jacobians;
  for (int r = 0; r < 2; ++r) {
    const double* const row = rows[r];
    double by_b[3], by_world[3], by_a[3], by_m[3], turn_h[3], turn_j[3];
    VectorMatrix3(row, camera.rotation, by_b);   // row^T C
    MatrixVector3(j.rotation, by_b, by_world);   // row^T C R_j^T
    VectorMatrix3(by_world, h.rotation, by_a);   // ... R_h
    MatrixVector3(camera.rotation, by_a, by_m);  // ... C^T
    Cross3(by_a, a, turn_h);
    Cross3(by_b, b, turn_j);
    double by_depth = 0, by_time = 0;
    for (int k = 0; k < 3; ++k) {
      out.by_anchor[6 * r + k] = -turn_h[k];
      out.by_anchor[6 * r + 3 + k] = depth * by_world[k];
      out.by_observer[6 * r + k] = turn_j[k];
      out.by_observer[6 * r + 3 + k] = -depth * by_world[k];
      out.by_camera[6 * r + k] = turn_h[k] - turn_j[k];
      out.by_camera[6 * r + 3 + k] = depth * (row[k] - by_m[k]);
      by_depth += row[k] * camera.translation[k] + by_world[k] * baseline[k];
      if (k < 2) by_time -= by_m[k] * sight.anchor_velocity[k];
    }
    out.by_point[3 * r] = by_m[0];
    out.by_point[3 * r + 1] = by_m[1];
    out.by_point[3 * r + 2] = by_depth;
    out.by_time[r] = by_time + scale * sight.velocity[r];
  }
  return true;
}

}  // namespace bundle
