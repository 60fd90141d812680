#include "core/inertial/propagation.h"

#include <algorithm>

#include "core/geometry/rotation.h"

namespace bundle {

void PropagateStates(const double state[16], const double gravity[3], IntegrationRule rule,
                     const double* gyro, const double* accel, const double* dt, int count,
                     double* out) {
  const bool midpoint = rule == IntegrationRule::kMidpoint;
  CheckSamples(gyro, accel, dt, count, rule);
  const double* gyro_bias = state + 10;
  const double* accel_bias = state + 13;
  double rotation[9];
  QuaternionToRotation(state, rotation);
  for (int k = 0; k < count; ++k) {
    double angle[3], force[3], end[3], quaternion[4], next[9], pull[3], end_pull[3];
    for (int i = 0; i < 3; ++i) {
      const int start = 3 * k + i, last = midpoint ? start + 3 : start;
      angle[i] = (0.5 * (gyro[start] + gyro[last]) - gyro_bias[i]) * dt[k];
      force[i] = accel[start] - accel_bias[i];
      end[i] = accel[last] - accel_bias[i];
    }
    double* after = out + 16 * k;
    std::copy(state, state + 16, after);
    ExpQuaternion(angle, quaternion);
    QuaternionProduct(state, quaternion, after);
    NormalizeQuaternion(after);
    QuaternionToRotation(after, next);
    MatrixVector3(rotation, force, pull);
    MatrixVector3(midpoint ? next : rotation, end, end_pull);
    for (int i = 0; i < 3; ++i) {
      const double acceleration = 0.5 * (pull[i] + end_pull[i]) + gravity[i];
      after[4 + i] += dt[k] * (state[7 + i] + 0.5 * dt[k] * acceleration);
      after[7 + i] += dt[k] * acceleration;
    }
    std::copy(next, next + 9, rotation);
    state = after;
  }
}

void PredictState(const Preintegration& motion, const double state[16], const double gravity[3],
                  double out[16]) {
  const double time = motion.duration();
  double turn[9], moved[3], gained[3], rotation[9], world_moved[3], world_gained[3];
  motion.Corrected(state + 10, state + 13, turn, moved, gained);
  double angle[3], quaternion[4];
  LogRotation(turn, angle);
  ExpQuaternion(angle, quaternion);
  QuaternionToRotation(state, rotation);
  MatrixVector3(rotation, moved, world_moved);
  MatrixVector3(rotation, gained, world_gained);
  double after[16];
  std::copy(state, state + 16, after);
  QuaternionProduct(state, quaternion, after);
  NormalizeQuaternion(after);
  for (int i = 0; i < 3; ++i) {
    after[4 + i] += time * (state[7 + i] + 0.5 * time * gravity[i]) + world_moved[i];
    after[7 + i] += time * gravity[i] + world_gained[i];
  }
  std::copy(after, after + 16, out);
}

}  // namespace bundle
