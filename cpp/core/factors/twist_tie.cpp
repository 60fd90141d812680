#include "core/factors/twist_tie.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/error.h"
#include "core/geometry/rigid_motion.h"

namespace bundle {

void TwistBetween(const double* pose_a, const double* pose_b, double num_frames, double* xi,
                  double* by_pose_b) {
  // T_b T_a^-1 = (R, t_b - R t_a)
  const double back[4] = {-pose_a[0], -pose_a[1], -pose_a[2], pose_a[3]};
  double motion[7], rotation[9], moved[3], log[6];
  QuaternionProduct(pose_b, back, motion);
  NormalizeQuaternion(motion);
  QuaternionToRotation(motion, rotation);
  MatrixVector3(rotation, pose_a + 4, moved);
  for (int i = 0; i < 3; ++i) motion[4 + i] = pose_b[4 + i] - moved[i];
  LogRigidMotion(motion, log);
  for (int i = 0; i < kTwistSize; ++i) xi[i] = log[i] / num_frames;
  if (by_pose_b == nullptr) return;
  double reversed[6], inverse[36], adjoint[36];
  for (int i = 0; i < 6; ++i) reversed[i] = -log[i];
  InverseLeftJacobianOfRigidMotion(reversed, inverse);  // the right one at log
  AdjointOfRigidMotion(pose_a, adjoint);
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      double sum = 0;
      for (int k = 0; k < 6; ++k) sum += inverse[6 * i + k] * adjoint[6 * k + j];
      by_pose_b[6 * i + j] = sum / num_frames;
    }
  }
}

namespace {

/// out = sign rho by_pose [R^T J_l, 0; 0, R^T]
void ByChart(const double* by_pose, const PoseState& state, double factor, double* out) {
  double turned[9];
  TransposedProduct3(state.rotation, state.left_jacobian, turned);
  for (int i = 0; i < kTwistSize; ++i) {
    for (int j = 0; j < 3; ++j) {
      double by_w = 0, by_t = 0;
      for (int k = 0; k < 3; ++k) {
        by_w += by_pose[6 * i + k] * turned[3 * k + j];
        by_t += by_pose[6 * i + 3 + k] * state.rotation[3 * j + k];
      }
      out[6 * i + j] = factor * by_w;
      out[6 * i + 3 + j] = factor * by_t;
    }
  }
}

}  // namespace

void HardTwist(const double* pose_a, const double* pose_b, const PoseState& state_a,
               const PoseState& state_b, double num_frames, double rho, double* twist,
               TwistMap* map) {
  double by_pose_b[36];
  TwistBetween(pose_a, pose_b, num_frames, map->readout, by_pose_b);
  for (int i = 0; i < kTwistSize; ++i) twist[i] = rho * map->readout[i];
  ByChart(by_pose_b, state_a, -rho, map->before);
  ByChart(by_pose_b, state_b, rho, map->after);
}

TwistTieFactor::TwistTieFactor(FactorHead head, double num_frames, double sigma_w, double sigma_v)
    : Factor(std::move(head),
             {Retraction(Manifold::kEuclidean, kTwistSize), Retraction(Manifold::kEuclidean, 1),
              Retraction(Manifold::kSe3, 7), Retraction(Manifold::kSe3, 7)},
             kTwistSize),
      num_frames_(num_frames),
      weights_{1 / sigma_w, 1 / sigma_v} {
  const bool is_of_rotation = sigma_v == std::numeric_limits<double>::infinity();
  const std::pair<const char*, double> given[] = {
      {"num_frames", num_frames}, {"sigma_w", sigma_w}, {"sigma_v", is_of_rotation ? 1 : sigma_v}};
  for (const auto& [what, value] : given) {
    if (value > 0 && std::isfinite(value)) continue;
    throw InputError(name() + ": " + what + ": expected a finite number above 0, found " +
                     ShortNumber(value));
  }
}

bool TwistTieFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const double *const twist = values[0], rho = values[1][0];
  double xi[kTwistSize], by_pose_b[36];
  TwistBetween(values[2], values[3], num_frames_, xi, jacobians == nullptr ? nullptr : by_pose_b);
  for (int i = 0; i < kTwistSize; ++i) residual[i] = weights_[i / 3] * (twist[i] - rho * xi[i]);
  if (jacobians == nullptr) return true;
  if (double* const by_twist = jacobians[0]; by_twist != nullptr) {
    std::fill_n(by_twist, 36, 0.0);
    for (int i = 0; i < 6; ++i) by_twist[7 * i] = weights_[i / 3];
  }
  for (int i = 0; i < 6 && jacobians[1] != nullptr; ++i) jacobians[1][i] = -weights_[i / 3] * xi[i];
  for (int i = 0; i < 36; ++i) {
    const double entry = weights_[i / 18] * rho * by_pose_b[i];
    if (jacobians[2] != nullptr) jacobians[2][i] = entry;
    if (jacobians[3] != nullptr) jacobians[3][i] = -entry;
  }
  return true;
}

}  // namespace bundle
