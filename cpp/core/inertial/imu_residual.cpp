#include "core/inertial/imu_residual.h"

/// Jacobians of the residual (Forster et al., TRO 2017, appendix C), for R Exp(d) and R' Exp(d').
///
/// Rotation: with r = r_R, dR^T R^T R' = Exp(r). A step of the last state multiplies Exp(r) by
/// Exp(d') on the right. A step of the first state puts Exp(-d) before R^T R'; this equals
/// Exp(-(R'^T R) d) after it:
///
///   dr/dd' = J_r(r)^-1,        dr/dd = -J_r(r)^-1 R'^T R.
///
/// A change e of the gyroscope's bias gives dR Exp(a + J e), a = J dbg with J = d dR / d bg. To
/// first order, this is dR Exp(a) Exp(J_r(a) J e). Its inverse is the factor before Exp(r), so that
///
///   dr/dbg = -J_r(r)^-1 Exp(r)^T J_r(a) J.
///
/// Position and velocity are y - dp and z - dv with y and z = R^T (...) of the header. A rotation
/// of R changes y to Exp(-d) y = y + [y]x d, and z likewise.
///
///          | d       p     v       bg     ba    | d'   p'    v'   | g
///   r_p    | [y]x   -R^T  -R^T T  -J_pg  -J_pa  |  0   R^T    0   | -1/2 R^T T^2
///   r_v    | [z]x    0    -R^T    -J_vg  -J_va  |  0    0    R^T  | -R^T T

#include <algorithm>

#include "core/geometry/rotation.h"

namespace bundle {

namespace {

constexpr int kStateSize = 15;
constexpr int kPositionColumn = 3, kVelocityColumn = 6, kGyroColumn = 9, kAccelColumn = 12;

/// A 3 x 3 block of a row-major matrix of `columns` <- scale m, or scale m^T.
void SetBlock(double* out, int columns, int row, int column, double scale, const double* m) {
  double* to = out + columns * row + column;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) to[columns * r + c] = scale * m[3 * r + c];
  }
}

void SetTransposedBlock(double* out, int columns, int row, int column, double scale,
                        const double* m) {
  double* to = out + columns * row + column;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) to[columns * r + c] = scale * m[3 * c + r];
  }
}

}  // namespace

ImuState ImuStateFromRow(const double row[16]) {
  ImuState state;
  QuaternionToRotation(row, state.rotation);
  std::copy(row + 4, row + 7, state.position);
  std::copy(row + 7, row + 10, state.velocity);
  std::copy(row + 10, row + 13, state.gyro_bias);
  std::copy(row + 13, row + 16, state.accel_bias);
  return state;
}

void ImuResidual(const Preintegration& motion, const ImuState& i, const ImuState& j,
                 const double gravity[3], double* residual, double* jacobian_i, double* jacobian_j,
                 double* jacobian_gravity) {
  const double time = motion.duration();
  double turn[9], moved[3], gained[3], between[9], error[9];
  motion.Corrected(i.gyro_bias, i.accel_bias, turn, moved, gained);
  TransposedProduct3(i.rotation, j.rotation, between);
  TransposedProduct3(turn, between, error);
  LogRotation(error, residual);

  double position[3], velocity[3], y[3], z[3];
  for (int k = 0; k < 3; ++k) {
    velocity[k] = j.velocity[k] - i.velocity[k] - gravity[k] * time;
    position[k] = j.position[k] - i.position[k] - time * (i.velocity[k] + 0.5 * time * gravity[k]);
  }
  VectorMatrix3(position, i.rotation, y);
  VectorMatrix3(velocity, i.rotation, z);
  for (int k = 0; k < 3; ++k) {
    residual[3 + k] = y[k] - moved[k];
    residual[6 + k] = z[k] - gained[k];
  }

  double inverse[9];  // J_r(r)^-1 = J_l(-r)^-1
  if (jacobian_i != nullptr || jacobian_j != nullptr) {
    const double opposite[3] = {-residual[0], -residual[1], -residual[2]};
    InverseLeftJacobian(opposite, inverse);
  }
  if (jacobian_i != nullptr) {
    std::fill_n(jacobian_i, 9 * kStateSize, 0.0);
    double block[9], product[9], back[9];
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) back[3 * r + c] = between[3 * c + r];
    }
    MatrixProduct3(inverse, back, block);
    SetBlock(jacobian_i, kStateSize, 0, 0, -1, block);

    double change[3], angle[3], right_jacobian[9];
    for (int k = 0; k < 3; ++k) change[k] = motion.gyro_bias()[k] - i.gyro_bias[k];
    MatrixVector3(motion.d_rotation_d_gyro_bias(), change, angle);
    LeftJacobian(angle, right_jacobian);  // of -a: J_r(a)
    MatrixProduct3(right_jacobian, motion.d_rotation_d_gyro_bias(), block);
    TransposedProduct3(error, block, product);
    MatrixProduct3(inverse, product, block);
    SetBlock(jacobian_i, kStateSize, 0, kGyroColumn, -1, block);

    Skew(y, block);
    SetBlock(jacobian_i, kStateSize, 3, 0, 1, block);
    SetTransposedBlock(jacobian_i, kStateSize, 3, kPositionColumn, -1, i.rotation);
    SetTransposedBlock(jacobian_i, kStateSize, 3, kVelocityColumn, -time, i.rotation);
    SetBlock(jacobian_i, kStateSize, 3, kGyroColumn, -1, motion.d_position_d_gyro_bias());
    SetBlock(jacobian_i, kStateSize, 3, kAccelColumn, -1, motion.d_position_d_accel_bias());
    Skew(z, block);
    SetBlock(jacobian_i, kStateSize, 6, 0, 1, block);
    SetTransposedBlock(jacobian_i, kStateSize, 6, kVelocityColumn, -1, i.rotation);
    SetBlock(jacobian_i, kStateSize, 6, kGyroColumn, -1, motion.d_velocity_d_gyro_bias());
    SetBlock(jacobian_i, kStateSize, 6, kAccelColumn, -1, motion.d_velocity_d_accel_bias());
  }
  if (jacobian_j != nullptr) {
    std::fill_n(jacobian_j, 9 * kStateSize, 0.0);
    SetBlock(jacobian_j, kStateSize, 0, 0, 1, inverse);
    SetTransposedBlock(jacobian_j, kStateSize, 3, kPositionColumn, 1, i.rotation);
    SetTransposedBlock(jacobian_j, kStateSize, 6, kVelocityColumn, 1, i.rotation);
  }
  if (jacobian_gravity != nullptr) {
    std::fill_n(jacobian_gravity, 9 * 3, 0.0);
    SetTransposedBlock(jacobian_gravity, 3, 3, 0, -0.5 * time * time, i.rotation);
    SetTransposedBlock(jacobian_gravity, 3, 6, 0, -time, i.rotation);
  }
}

void WhitenImu(const Preintegration& motion, double* m, int columns) {
  const std::array<double, 81>& w = motion.sqrt_information();
  for (int r = 0; r < 9; ++r) {  // upper triangular: a row needs itself and those below it
    for (int c = 0; c < columns; ++c) m[r * columns + c] *= w[9 * r + r];
    for (int k = r + 1; k < 9; ++k) {
      const double factor = w[9 * r + k];
      for (int c = 0; c < columns; ++c) m[r * columns + c] += factor * m[k * columns + c];
    }
  }
}

}  // namespace bundle
