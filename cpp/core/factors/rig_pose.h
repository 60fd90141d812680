#pragma once

/// Poses of images on rigs, and how they move with their frame and their sensor.
///
/// A frame has rig_from_world (R_f, t_f), a sensor sensor_from_rig (R_s, t_s); both are variables
/// in the chart of reprojection.h, with left Jacobians J_f and J_s. Their image is at
///
///   cam_from_world = sensor_from_rig * rig_from_world:    R = R_s R_f,    t = R_s t_f + t_s.
///
/// Let phi and tau be its *local coordinates*: R goes to Exp(phi) R and t to t + tau. They follow
/// from steps (dw_f, dt_f) and (dw_s, dt_s), by R_s Exp(a) = Exp(R_s a) R_s, to first order as
///
///   phi = R_s J_f dw_f                +  J_s dw_s
///   tau =                 R_s dt_f    +  (J_s dw_s) x (R_s t_f)  +  dt_s,
///
/// which are the maps, 6 x 6,
///
///   M_f = | R_s J_f      |      M_s = |         J_s          |      with c = R_s t_f.
///         |          R_s |            | -[c]x J_s          I |
///
/// An image of the reference sensor has R_s = I, t_s = 0 and no M_s. The fused backend linearises
/// by the chart of the frame, which costs the same as the chart of an image's own pose. A step of
/// the sensor then moves the image like a step of the frame multiplied by
///
///   K = M_f^-1 M_s = | J_f^-1 A         |      with A = R_s^T J_s,
///                    | -[t_f]x A   R_s^T|
///
/// where J_f^-1 exists, because |v| is at most pi where derivatives are computed.

#include <algorithm>

#include "core/factors/reprojection.h"
#include "core/geometry/rotation.h"

namespace bundle {

/// Frame and sensor from which an image's pose follows. Both are nullptr if the pose is a variable
/// itself. The sensor is nullptr for a reference sensor.
struct RigPose {
  const PoseState* frame = nullptr;
  const PoseState* sensor = nullptr;
};

inline constexpr double kIdentity3[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

/// The pose of an image. Its left Jacobian is set to the identity, as for local coordinates.
inline void ComposePose(const RigPose& rig, PoseState* image) {
  std::copy_n(kIdentity3, 9, image->left_jacobian);
  if (rig.sensor == nullptr) {
    std::copy_n(rig.frame->rotation, 9, image->rotation);
    std::copy_n(rig.frame->translation, 3, image->translation);
    return;
  }
  MatrixProduct3(rig.sensor->rotation, rig.frame->rotation, image->rotation);
  MatrixVector3(rig.sensor->rotation, rig.frame->translation, image->translation);
  for (int i = 0; i < 3; ++i) image->translation[i] += rig.sensor->translation[i];
}

/// A row-major 6 x 6 matrix [a b; c d] of 3 x 3 blocks; nullptr: zero block.
inline void JoinBlocks(const double* a, const double* b, const double* c, const double* d,
                       double* out) {
  const double* const blocks[4] = {a, b, c, d};
  for (int k = 0; k < 4; ++k) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        out[6 * (3 * (k / 2) + i) + 3 * (k % 2) + j] =
            blocks[k] == nullptr ? 0 : blocks[k][3 * i + j];
      }
    }
  }
}

/// -[a]x m
inline void MinusCross(const double* a, const double* m, double* out) {
  for (int j = 0; j < 3; ++j) {
    const double column[3] = {m[j], m[3 + j], m[6 + j]};
    double product[3];
    Cross3(column, a, product);
    for (int i = 0; i < 3; ++i) out[3 * i + j] = product[i];
  }
}

/// Inverse by the adjugate, for matrices as well conditioned as J_l for |v| <= pi.
inline void InvertMatrix3(const double* m, double* out) {
  double rows[9];  // cross products of columns
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const double a[3] = {m[j], m[3 + j], m[6 + j]}, b[3] = {m[k], m[3 + k], m[6 + k]};
    Cross3(a, b, rows + 3 * i);
  }
  const double determinant = m[0] * rows[0] + m[3] * rows[1] + m[6] * rows[2];
  for (int i = 0; i < 9; ++i) out[i] = rows[i] / determinant;
}

/// M_f
inline void FrameMap(const RigPose& rig, double map[36]) {
  const double* const rotation = rig.sensor == nullptr ? kIdentity3 : rig.sensor->rotation;
  double turned[9];
  MatrixProduct3(rotation, rig.frame->left_jacobian, turned);
  JoinBlocks(turned, nullptr, nullptr, rotation, map);
}

/// Converts a row of six by local coordinates of an image to a row by the unknowns of a map.
inline void RowTimesMap(const double* row, const double map[36], double* out) {
  for (int j = 0; j < 6; ++j) {
    out[j] = 0;
    for (int i = 0; i < 6; ++i) out[j] += row[i] * map[6 * i + j];
  }
}

/// M_s, if the image has a sensor.
inline void SensorMap(const RigPose& rig, double map[36]) {
  double lever[3], moved[9];
  MatrixVector3(rig.sensor->rotation, rig.frame->translation, lever);
  MinusCross(lever, rig.sensor->left_jacobian, moved);
  JoinBlocks(rig.sensor->left_jacobian, nullptr, moved, kIdentity3, map);
}

/// K, if the image has a sensor.
inline void SensorByFrameMap(const RigPose& rig, double map[36]) {
  double back[9], a[9], turned[9], moved[9], inverse[9];
  for (int i = 0; i < 9; ++i) back[i] = rig.sensor->rotation[3 * (i % 3) + i / 3];
  MatrixProduct3(back, rig.sensor->left_jacobian, a);
  InvertMatrix3(rig.frame->left_jacobian, inverse);
  MatrixProduct3(inverse, a, turned);
  MinusCross(rig.frame->translation, a, moved);
  JoinBlocks(turned, nullptr, moved, back, map);
}

}  // namespace bundle
