#pragma once

/// Preintegration: IMU samples between two states as one relative motion with its covariance.

#include <array>
#include <vector>

namespace bundle {

/// Densities of an IMU's noise, in continuous time. SI units and radians.
struct ImuNoise {
  double gyro_noise_density = 0;      ///< rad/s/sqrt(Hz), above 0
  double accel_noise_density = 0;     ///< m/s^2/sqrt(Hz), above 0
  double gyro_bias_random_walk = 0;   ///< rad/s^2/sqrt(Hz)
  double accel_bias_random_walk = 0;  ///< m/s^3/sqrt(Hz)
  /// m^2/s: error of the integration of velocity to position, per axis.
  double integration_covariance = 1e-8;
};

/// Assumption on the motion between two samples.
enum class IntegrationRule {
  kZeroOrderHold,  ///< a sample holds for the interval that follows it
  kMidpoint,       ///< the mean of the samples at both ends of an interval
};

/// An interval of time with the IMU's measurement in it.
struct ImuSample {
  double dt;            ///< s
  double gyro[3];       ///< rad/s; by midpoint the mean of both ends
  double accel[3];      ///< m/s^2, specific force at the start
  double accel_end[3];  ///< at the end; unused with zero-order hold
};

/// Throws InputError if a number is not finite or a dt is not above 0. Arrays as in
/// Preintegration::Integrate.
void CheckSamples(const double* gyro, const double* accel, const double* dt, int count,
                  IntegrationRule rule);

/// Motion between two states from the IMU alone, in the IMU's frame at the first state.
///
/// preintegration.cpp has the derivation. Matrices are row-major; rows of the covariance and of its
/// square root are in the order rotation, position, velocity.
class Preintegration {
 public:
  /// Throws InputError if a density or bias is not finite, a density of gyroscope or accelerometer
  /// is not above 0, or another density is below 0.
  Preintegration(const ImuNoise& noise, const double gyro_bias[3], const double accel_bias[3],
                 IntegrationRule rule = IntegrationRule::kZeroOrderHold);

  /// Integrates `count` intervals of dt seconds. `gyro` and `accel` are count x 3 with zero-order
  /// hold, (count + 1) x 3 by midpoint: a sample at each end, so that the first row of a call is
  /// the last row of the previous call. Throws InputError, without any change, if a number is not
  /// finite or a dt is not above 0.
  void Integrate(const double* gyro, const double* accel, const double* dt, int count);
  /// Integrates the samples of the next interval, at the biases of this object.
  void Append(const Preintegration& next);
  void Append(const std::vector<ImuSample>& samples);
  /// Preintegrates the same samples at other biases.
  Preintegration Repropagated(const double gyro_bias[3], const double accel_bias[3]) const;
  /// The deltas at other biases, to first order in them.
  void Corrected(const double gyro_bias[3], const double accel_bias[3], double rotation[9],
                 double position[3], double velocity[3]) const;
  /// 15 x 15, by rotation, position, velocity, gyroscope bias, accelerometer bias: covariance of
  /// the residual followed by b_j - b_i, for biases with a random walk from b_i at the start.
  /// Integrates the samples.
  void CombinedCovariance(double out[225]) const;

  const ImuNoise& noise() const { return noise_; }
  IntegrationRule rule() const { return rule_; }
  const double* gyro_bias() const { return gyro_bias_.data(); }
  const double* accel_bias() const { return accel_bias_.data(); }
  const std::vector<ImuSample>& samples() const { return samples_; }

  double duration() const { return duration_; }  ///< s
  double turned() const { return turned_; }      ///< rad, sum of |angle| over all samples
  const double* delta_rotation() const { return rotation_.data(); }
  const double* delta_position() const { return position_.data(); }
  const double* delta_velocity() const { return velocity_.data(); }
  /// 3 x 3 each.
  const double* d_rotation_d_gyro_bias() const { return rotation_by_gyro_.data(); }
  const double* d_position_d_gyro_bias() const { return position_by_gyro_.data(); }
  const double* d_position_d_accel_bias() const { return position_by_accel_.data(); }
  const double* d_velocity_d_gyro_bias() const { return velocity_by_gyro_.data(); }
  const double* d_velocity_d_accel_bias() const { return velocity_by_accel_.data(); }
  /// 9 x 9.
  std::array<double, 81> covariance() const;
  /// W, 9 x 9, upper triangular with W^T W = covariance^-1. Throws InputError if the covariance is
  /// not positive definite: too few samples without an integration covariance.
  const std::array<double, 81>& sqrt_information() const;

 private:
  using Vector = std::array<double, 3>;
  using Matrix = std::array<double, 9>;

  void Add(const ImuSample& sample);
  void Shear(const double k[3], double half_dt, double drift);
  void Finish();

  ImuNoise noise_;
  IntegrationRule rule_;
  Vector gyro_bias_, accel_bias_;
  std::vector<ImuSample> samples_;

  double duration_ = 0, turned_ = 0;
  Matrix rotation_ = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  Vector position_ = {}, velocity_ = {};
  Matrix rotation_by_gyro_ = {}, position_by_gyro_ = {}, position_by_accel_ = {};
  Matrix velocity_by_gyro_ = {}, velocity_by_accel_ = {};
  /// With the error of the rotation in the frame of the start: its Jacobian, its rows of the
  /// covariance (3 x 9), and the blocks below these rows.
  Matrix turn_by_gyro_ = {};
  std::array<double, 27> of_rotation_ = {};
  Matrix of_position_ = {}, position_velocity_ = {}, of_velocity_ = {};
  std::array<double, 81> sqrt_information_ = {};
  bool has_information_ = false;
};

}  // namespace bundle
