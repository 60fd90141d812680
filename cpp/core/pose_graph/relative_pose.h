#pragma once

/// The error of a relative pose, and its Jacobians.
///
/// Poses X are world_from_body; an edge from i to j measures Z = X_i^-1 X_j. With
///
///   B = X_i^-1 X_j,      M = Z^-1 B,
///
/// M is the identity if the poses agree with the measurement. There are three errors:
///
///   log   r = Log(M), the logarithm of SE(2) or SE(3) as a whole (rigid_motion.h), which couples
///         translation and rotation; GTSAM's BetweenFactor, 2D included.
///   g2o   r = (t, theta) of M in 2D, r = (q_v, t) of M in 3D, q_v the vector part of the
///         quaternion (q_v, q_w) of M with q_w >= 0: half the rotation vector at small angles, so
///         that the same information weighs rotations a quarter as much.
///   ceres r = (t_B - t_Z, theta_B - theta_Z) in 2D, r = (2 d_v, t_B - t_Z) in 3D,
///         d_v the vector part of q_Z q_B^-1 with d_w >= 0; that of Ceres' examples
///         pose_graph_2d and pose_graph_3d. Its translation is not rotated into the frame of the
///         measurement.
///
/// All are in the order of the tangent coordinates (geometry/retraction.h): in 3D the rotation
/// comes first. Poses move by the right perturbation X Exp(d). For X_j,
///
///   M -> M Exp(d):      dr = E d + O(|d|^2),
///
/// and for X_i, with B^-1 = X_j^-1 X_i and X Exp(d) X^-1 = Exp(Ad_X d),
///
///   M -> Z^-1 Exp(-d) X_i^-1 X_j = M Exp(-Ad(B^-1) d).
///
/// So one matrix gives both Jacobians, J_j = E and J_i = -E Ad(B^-1), where
///
///   log   E = J_r(r)^-1, the inverse right Jacobian;
///   g2o   in 2D, from t -> t + R_M v and theta -> theta + a, E = diag(R_M, 1);
///         in 3D, from q -> q (w/2, 1) and t -> t + R_M v (both to first order),
///         E = diag(1/2 (q_w I + [q_v]x), R_M);
///   ceres in 2D E = diag(R_B, 1); in 3D, from q_Z (q_B Exp(w))^-1 = d Exp(-R_B w),
///         E = diag(-(d_w I + [d_v]x) R_B, R_B).
///
/// The angle of M is in [-pi, pi] for any number of turns of the poses' angles. So errors do not
/// jump where angles wrap. They jump only where prediction and measurement differ by half a turn.
/// No error function is smooth there.

#include <cmath>

#include "core/geometry/retraction.h"
#include "core/geometry/rigid_motion.h"

namespace bundle {

enum class PoseError { kLog, kG2o, kCeres };

/// A record is a pose in the form that errors read: in 2D x y angle, then the cosine and the
/// sine of the angle. They are computed once per pose, not once per edge. Its size allows reading
/// the records of several edges at a time.
struct Se2 {
  static constexpr Manifold kManifold = Manifold::kSe2;
  static constexpr int kAmbient = 3;
  static constexpr int kTangent = 3;
  static constexpr int kRecord = 8;
  static void Record(const double* pose, double* record) {
    const double angle = pose[2], c = std::cos(angle), s = std::sin(angle);  // in one call
    record[0] = pose[0], record[1] = pose[1], record[2] = angle, record[3] = c, record[4] = s;
  }
  /// X Exp(d) of a record, and its record, without another cosine and sine: each step adds an error
  /// of one rounding to them.
  static void Move(const double* x, const double* d, double* moved, double* record) {
    double step[5];
    ExpPlanarMotion(d, step);
    record[0] = moved[0] = x[0] + x[3] * step[0] - x[4] * step[1];
    record[1] = moved[1] = x[1] + x[4] * step[0] + x[3] * step[1];
    record[2] = moved[2] = x[2] + step[2];
    record[3] = x[3] * step[3] - x[4] * step[4];
    record[4] = x[4] * step[3] + x[3] * step[4];
  }
};

struct Se3 {
  static constexpr Manifold kManifold = Manifold::kSe3;
  static constexpr int kAmbient = 7;
  static constexpr int kTangent = 6;
  static constexpr int kRecord = 8;
  static void Record(const double* pose, double* record) {
    for (int k = 0; k < 7; ++k) record[k] = pose[k];
  }
  static void Move(const double* x, const double* d, double* moved, double* record) {
    Retraction(kManifold, kAmbient).Plus(x, d, moved);
    Record(moved, record);
  }
};

/// The record of X^-1 Y in 2D, from records.
template <typename T>
void PlanarMotionFromRecord(const T* x, const T* y, T out[5]) {
  const T apart[2] = {y[0] - x[0], y[1] - x[1]};
  out[0] = x[3] * apart[0] + x[4] * apart[1];
  out[1] = x[3] * apart[1] - x[4] * apart[0];
  out[2] = y[2] - x[2];
  out[3] = x[3] * y[3] + x[4] * y[4];
  out[4] = x[3] * y[4] - x[4] * y[3];
}

template <typename T>
void EvaluatePlanarPose(PoseError error, const T* x_i, const T* x_j, const T* z, T* residual,
                        T* right, T* adjoint) {
  T between[5], motion[5];
  PlanarMotionFromRecord(x_i, x_j, between);
  PlanarMotionFromRecord(z, between, motion);
  if (error == PoseError::kLog) {
    LogPlanarMotion(motion, residual);
  } else {
    const bool turned = error == PoseError::kG2o;
    for (int i = 0; i < 2; ++i) residual[i] = turned ? motion[i] : between[i] - z[i];
    residual[2] = WrapAngle(motion[2]);
  }
  if (right == nullptr) return;
  if (error == PoseError::kLog) {
    InverseRightJacobianOfPlanarMotion(residual, right);
  } else {
    const T* const turn = error == PoseError::kG2o ? motion : between;
    const T rotated[9] = {turn[3], -turn[4], 0, turn[4], turn[3], 0, 0, 0, 1};
    for (int i = 0; i < 9; ++i) right[i] = rotated[i];
  }
  T back[5];
  PlanarMotionFromRecord(x_j, x_i, back);
  const T of_back[9] = {back[3], -back[4], back[1], back[4], back[3], -back[0], 0, 0, 1};
  for (int i = 0; i < 9; ++i) adjoint[i] = of_back[i];
}

/// out = diag(a, b) of 3x3 matrices.
template <typename T>
void DiagonalBlocks(const T* a, const T* b, T* out) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[6 * r + c] = a[3 * r + c];
      out[6 * (r + 3) + c + 3] = b[3 * r + c];
      out[6 * r + c + 3] = out[6 * (r + 3) + c] = 0;
    }
  }
}

template <typename T>
void EvaluateSpatialPose(PoseError error, const T* x_i, const T* x_j, const T* z, T* residual,
                         T* right, T* adjoint) {
  T between[7], motion[7];
  RigidMotionBetween(x_i, x_j, between);
  RigidMotionBetween(z, between, motion);
  T delta[4];  // of error ceres q_Z q_B^-1, of g2o the quaternion of M; the last one positive
  if (error == PoseError::kLog) {
    LogRigidMotion(motion, residual);
  } else {
    const bool is_ceres = error == PoseError::kCeres;
    const T back[4] = {-between[0], -between[1], -between[2], between[3]};
    T quaternion[4];
    QuaternionProduct(z, back, quaternion);
    const T* const q = is_ceres ? quaternion : motion;
    const T sign = SignOf(q[3]);
    for (int i = 0; i < 4; ++i) delta[i] = sign * q[i];
    for (int i = 0; i < 3; ++i) {
      residual[i] = is_ceres ? 2 * delta[i] : delta[i];
      residual[3 + i] = is_ceres ? between[4 + i] - z[4 + i] : motion[4 + i];
    }
  }
  if (right == nullptr) return;
  if (error == PoseError::kLog) {
    T negative[6];
    for (int i = 0; i < 6; ++i) negative[i] = -residual[i];
    InverseLeftJacobianOfRigidMotion(negative, right);
  } else {
    T rotation[9], skew[9], product[9];
    Skew(delta, skew);
    for (int i = 0; i < 3; ++i) skew[4 * i] += delta[3];
    if (error == PoseError::kCeres) {
      QuaternionToRotation(between, rotation);
      MatrixProduct3(skew, rotation, product);
      for (int i = 0; i < 9; ++i) product[i] = -product[i];
    } else {
      QuaternionToRotation(motion, rotation);
      for (int i = 0; i < 9; ++i) product[i] = 0.5 * skew[i];
    }
    DiagonalBlocks(product, rotation, right);
  }
  T back[7];
  RigidMotionBetween(x_j, x_i, back);
  AdjointOfRigidMotion(back, adjoint);
}

/// `x_i`, `x_j` and `z` are records. `residual`: kTangent numbers. `right` is E and `adjoint`
/// Ad(B^-1), kTangent squared, row-major; both or neither may be nullptr. Quaternions have norm 1.
template <typename Group, typename T>
void EvaluateRelativePose(PoseError error, const T* x_i, const T* x_j, const T* z, T* residual,
                          T* right, T* adjoint) {
  if constexpr (Group::kTangent == 3) {
    EvaluatePlanarPose(error, x_i, x_j, z, residual, right, adjoint);
  } else {
    EvaluateSpatialPose(error, x_i, x_j, z, residual, right, adjoint);
  }
}

}  // namespace bundle
