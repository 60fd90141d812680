#pragma once

/// The residual of two states that are connected by IMU samples, with its Jacobians.
///
/// With (R, p, v) and (R', p', v') of the states at both ends, world_from_imu, T the duration, g
/// gravity, and (dR, dp, dv) the preintegrated motion corrected to the biases of the first state,
///
///   r_R = Log(dR^T R^T R'),
///   r_p = R^T (p' - p - v T - 1/2 g T^2) - dp,
///   r_v = R^T (v' - v - g T) - dv.
///
/// imu_residual.cpp derives the Jacobians.

#include "core/inertial/preintegration.h"

namespace bundle {

/// A state's 15 tangent coordinates: rotation by R Exp(d), position and velocity in the world,
/// biases of gyroscope and accelerometer.
struct ImuState {
  double rotation[9];    ///< world_from_imu, row-major
  double position[3];    ///< m, in the world
  double velocity[3];    ///< m/s, in the world
  double gyro_bias[3];   ///< rad/s
  double accel_bias[3];  ///< m/s^2
};

/// From `qx qy qz qw  px py pz  vx vy vz  bgx bgy bgz  bax bay baz`.
ImuState ImuStateFromRow(const double row[16]);

/// Unwhitened, in the order rotation, position, velocity: 9 numbers. `jacobian_i` and `jacobian_j`
/// are 9 x 15 by the tangent coordinates, `jacobian_gravity` 9 x 3, all row-major; each may be
/// nullptr. The biases of `j` have no effect.
void ImuResidual(const Preintegration& motion, const ImuState& i, const ImuState& j,
                 const double gravity[3], double* residual, double* jacobian_i, double* jacobian_j,
                 double* jacobian_gravity);

/// m <- W m with W the square root of the information, 9 x columns, row-major. Throws InputError if
/// it does not exist.
void WhitenImu(const Preintegration& motion, double* m, int columns);

}  // namespace bundle
