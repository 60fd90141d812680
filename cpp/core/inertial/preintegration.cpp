/// Preintegration on the manifold (Forster, Carlone, Dellaert, Scaramuzza, "On-Manifold
/// Preintegration for Real-Time Visual-Inertial Odometry", TRO 2017).
///
/// A gyroscope measures w~ = w + bg + noise, an accelerometer f~ = R^T (a - g) + ba + noise, R
/// being world_from_imu. With w = w~ - bg, f = f~ - ba, and H = dR times a force, the motion
/// relative to the frame at the start, without gravity, moves in an interval dt by
///
///   p += v dt + 1/2 dR f dt^2,      v += dR f dt,      dR <- dR E,      E = Exp(w dt),
///
/// in this order: position takes the velocity and the rotation of the interval's start.
/// By midpoint the force is 1/2 (dR f + dR E f'), f' at the interval's end, and w~ the mean of
/// both.
///
/// Errors. With dR Exp(t), p and v of errors (t, dp, dv), a force turned by dR changes by
/// -dR [f]x t. So with
///
///   K = -dR [f]x dt        (by midpoint two: K0 = -1/2 dR [f]x dt, K1 = -1/2 dR E [f']x dt)
///
/// an interval is a shear with K, then the turn t <- E^T t - J_r dt dbg, and by midpoint a shear
/// with K0, the turn, and a shear with K1 that has no drift:
///
///   shear:   dp += drift dv + 1/2 dt K t,     dv += K t,      drift = dt (or 0 for K1).
///
/// The Jacobians by the gyroscope's bias are three columns (J_R, J_p, J_v) of such errors, those by
/// the accelerometer's bias move by -1/2 M dt^2 and -M dt with M = dR, or 1/2 (dR + dR E).
///
/// Covariance. White noise of density s has variance s^2 / dt in a mean over dt. The gyroscope's
/// enters with the turn as J_r J_r^T s^2 dt, and with J_r = I - b W + c W^2, W = [w dt]x of angle
/// a, J_r J_r^T = I + (2c - b^2 - c^2 a^2) W^2. The accelerometer's enters as that of a mean force
/// in any frame, which no rotation changes: s^2 (dt^3/4, dt^2/2, dt) I for (pp, pv, vv). A third,
/// integration_covariance dt I, goes to the position.
/// The blocks of A C A^T for a shear follow with Y = K (C_tt C_tp C_tv) = (X U V), Z = X K^T:
///
///   tp += drift tv + 1/2 dt X^T        pp += drift (pv + pv^T) + drift^2 vv + 1/2 dt (U + U^T)
///   tv += X^T                                + 1/2 dt drift (V + V^T) + 1/4 dt^2 Z
///   vv += V + V^T + Z                  pv += drift vv + 1/2 dt V + U^T + drift V^T + 1/2 dt Z

#include "core/inertial/preintegration.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "core/error.h"
#include "core/geometry/rotation.h"

namespace bundle {

namespace {

/// out = a b^T
void TimesTransposed(const double* a, const double* b, double* out) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[3 * r + c] =
          a[3 * r] * b[3 * c] + a[3 * r + 1] * b[3 * c + 1] + a[3 * r + 2] * b[3 * c + 2];
    }
  }
}

/// out = scale m [v]x
void TimesSkew(double scale, const double* m, const double* v, double* out) {
  for (int r = 0; r < 3; ++r) {
    const double x = scale * m[3 * r], y = scale * m[3 * r + 1], z = scale * m[3 * r + 2];
    out[3 * r] = y * v[2] - z * v[1];
    out[3 * r + 1] = z * v[0] - x * v[2];
    out[3 * r + 2] = x * v[1] - y * v[0];
  }
}

/// out = m rows, 3 x 9
void TimesRows(const double* m, const double* rows, double* out) {
  for (int r = 0; r < 3; ++r) {
    const double x = m[3 * r], y = m[3 * r + 1], z = m[3 * r + 2];
    for (int c = 0; c < 9; ++c) out[9 * r + c] = x * rows[c] + y * rows[9 + c] + z * rows[18 + c];
  }
}

void Transpose(const double* m, double* out) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) out[3 * c + r] = m[3 * r + c];
  }
}

void RequireFinite(const char* what, const double* numbers, int count, int columns) {
  for (int i = 0; i < count; ++i) {
    if (std::isfinite(numbers[i])) continue;
    const std::string row = columns > 1 ? std::to_string(i / columns) + ", " : "";
    throw InputError(std::string(what) + "[" + row + std::to_string(i % columns) +
                     "]: expected a finite number, found " + std::to_string(numbers[i]));
  }
}

void RequireDensity(const char* what, double value, bool may_be_zero) {
  if (std::isfinite(value) && (value > 0 || (may_be_zero && value == 0))) return;
  throw InputError(std::string(what) + ": expected a finite number " +
                   (may_be_zero ? "of at least 0" : "above 0") + ", found " +
                   std::to_string(value));
}

}  // namespace

Preintegration::Preintegration(const ImuNoise& noise, const double gyro_bias[3],
                               const double accel_bias[3], IntegrationRule rule)
    : noise_(noise), rule_(rule) {
  RequireDensity("gyro_noise_density", noise.gyro_noise_density, false);
  RequireDensity("accel_noise_density", noise.accel_noise_density, false);
  RequireDensity("gyro_bias_random_walk", noise.gyro_bias_random_walk, true);
  RequireDensity("accel_bias_random_walk", noise.accel_bias_random_walk, true);
  RequireDensity("integration_covariance", noise.integration_covariance, true);
  RequireFinite("gyro_bias", gyro_bias, 3, 1);
  RequireFinite("accel_bias", accel_bias, 3, 1);
  std::copy(gyro_bias, gyro_bias + 3, gyro_bias_.begin());
  std::copy(accel_bias, accel_bias + 3, accel_bias_.begin());
}

void Preintegration::Integrate(const double* gyro, const double* accel, const double* dt,
                               int count) {
  const bool midpoint = rule_ == IntegrationRule::kMidpoint;
  const int rows = count + (midpoint && count > 0 ? 1 : 0);
  RequireFinite("gyro", gyro, 3 * rows, 3);
  RequireFinite("accel", accel, 3 * rows, 3);
  for (int k = 0; k < count; ++k) {
    if (dt[k] > 0 && std::isfinite(dt[k])) continue;
    throw InputError("dt[" + std::to_string(k) + "]: expected a time above 0 s, found " +
                     std::to_string(dt[k]));
  }
  samples_.reserve(std::max(samples_.capacity(), samples_.size() + count));
  for (int k = 0; k < count; ++k) {
    ImuSample sample;
    sample.dt = dt[k];
    for (int i = 0; i < 3; ++i) {
      const int start = 3 * k + i, end = midpoint ? start + 3 : start;
      sample.gyro[i] = midpoint ? 0.5 * (gyro[start] + gyro[end]) : gyro[start];
      sample.accel[i] = accel[start];
      sample.accel_end[i] = accel[end];
    }
    samples_.push_back(sample);
    Add(sample);
  }
  UpdateSqrtInformation();
}

void Preintegration::Append(const Preintegration& next) {
  if (next.rule_ != rule_) {
    throw InputError("append: expected samples of the same integration rule");
  }
  const std::vector<ImuSample> added = next.samples_;  // `next` may be *this
  samples_.insert(samples_.end(), added.begin(), added.end());
  for (const ImuSample& sample : added) Add(sample);
  UpdateSqrtInformation();
}

Preintegration Preintegration::Repropagated(const double gyro_bias[3],
                                            const double accel_bias[3]) const {
  Preintegration out(noise_, gyro_bias, accel_bias, rule_);
  out.samples_ = samples_;
  for (const ImuSample& sample : samples_) out.Add(sample);
  out.UpdateSqrtInformation();
  return out;
}

/// One interval.
void Preintegration::Add(const ImuSample& sample) {
  const double dt = sample.dt, half = 0.5 * dt;
  double turn[3], force[3];
  for (int i = 0; i < 3; ++i) {
    turn[i] = (sample.gyro[i] - gyro_bias_[i]) * dt;
    force[i] = sample.accel[i] - accel_bias_[i];
  }
  const double angle_squared = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2];
  const RotationCoefficients k = ExpCoefficients(angle_squared);
  double turned[9], right_jacobian[9], gyro_noise[9], rotation[9];
  SkewPolynomial(turn, k.a, k.b, turned);
  SkewPolynomial(turn, -k.b, k.c, right_jacobian);
  SkewPolynomial(turn, 0, 2 * k.c - k.b * k.b - k.c * k.c * angle_squared, gyro_noise);
  MatrixProduct3(rotation_.data(), turned, rotation);

  double by_rotation[9], world_force[3], mean_rotation[9];
  MatrixVector3(rotation_.data(), force, world_force);
  if (rule_ == IntegrationRule::kMidpoint) {
    double end[3], world_end[3];
    for (int i = 0; i < 3; ++i) end[i] = sample.accel_end[i] - accel_bias_[i];
    MatrixVector3(rotation, end, world_end);
    for (int i = 0; i < 3; ++i) world_force[i] = 0.5 * (world_force[i] + world_end[i]);
    for (int i = 0; i < 9; ++i) mean_rotation[i] = 0.5 * (rotation_[i] + rotation[i]);
    TimesSkew(-half, rotation_.data(), force, by_rotation);
    Shear(by_rotation, half, dt);
    Rotate(turned, right_jacobian, dt, gyro_noise);
    TimesSkew(-half, rotation, end, by_rotation);
    Shear(by_rotation, half, 0);
  } else {
    std::copy(rotation_.begin(), rotation_.end(), mean_rotation);
    TimesSkew(-dt, rotation_.data(), force, by_rotation);
    Shear(by_rotation, half, dt);
    Rotate(turned, right_jacobian, dt, gyro_noise);
  }

  const double accel_variance = noise_.accel_noise_density * noise_.accel_noise_density * dt;
  const double position_variance =
      0.25 * dt * dt * accel_variance + noise_.integration_covariance * dt;
  for (int i = 0; i < 9; ++i) {
    position_by_accel_[i] += dt * velocity_by_accel_[i] - half * dt * mean_rotation[i];
    velocity_by_accel_[i] -= dt * mean_rotation[i];
  }
  for (int i = 0; i < 9; i += 4) {
    of_position_[i] += position_variance;
    position_velocity_[i] += half * accel_variance;
    of_velocity_[i] += accel_variance;
  }
  for (int i = 0; i < 3; ++i) {
    position_[i] += dt * (velocity_[i] + half * world_force[i]);
    velocity_[i] += dt * world_force[i];
  }
  std::copy(rotation, rotation + 9, rotation_.begin());
  duration_ += dt;
  turned_ += std::sqrt(angle_squared);
}

/// The shear of the derivation above.
void Preintegration::Shear(const double* by_rotation, double half_dt, double drift) {
  double y[27], x[9], transposed[9], z[9], by_gyro[9];
  TimesRows(by_rotation, of_rotation_.data(), y);
  for (int r = 0; r < 3; ++r) std::copy(y + 9 * r, y + 9 * r + 3, x + 3 * r);
  TimesTransposed(x, by_rotation, z);
  Transpose(x, transposed);
  MatrixProduct3(by_rotation, rotation_by_gyro_.data(), by_gyro);
  const double* u = y + 3;  // rows of nine numbers
  const double* v = y + 6;
  const Matrix pv = position_velocity_;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const int i = 3 * r + c, i9 = 9 * r + c, t = 3 * c + r, t9 = 9 * c + r;
      of_position_[i] += drift * (pv[i] + pv[t] + drift * of_velocity_[i]) +
                         half_dt * (u[i9] + u[t9] + drift * (v[i9] + v[t9]) + half_dt * z[i]);
      position_velocity_[i] += drift * (of_velocity_[i] + v[t9]) + half_dt * (v[i9] + z[i]) + u[t9];
    }
  }
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const int i = 3 * r + c, i9 = 9 * r + c, t9 = 9 * c + r;
      of_velocity_[i] += v[i9] + v[t9] + z[i];
      of_rotation_[i9 + 3] += drift * of_rotation_[i9 + 6] + half_dt * transposed[i];
      of_rotation_[i9 + 6] += transposed[i];
      position_by_gyro_[i] += drift * velocity_by_gyro_[i] + half_dt * by_gyro[i];
      velocity_by_gyro_[i] += by_gyro[i];
    }
  }
}

/// The turn by E with J_r and J_r J_r^T.
void Preintegration::Rotate(const double* turn, const double* by_bias, double dt,
                            const double* noise) {
  double inverse[9], rows[27], block[9], turned[9];
  Transpose(turn, inverse);
  TimesRows(inverse, of_rotation_.data(), rows);
  for (int r = 0; r < 3; ++r) std::copy(rows + 9 * r, rows + 9 * r + 3, block + 3 * r);
  MatrixProduct3(block, turn, turned);
  std::copy(rows, rows + 27, of_rotation_.begin());
  const double variance = noise_.gyro_noise_density * noise_.gyro_noise_density * dt;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      of_rotation_[9 * r + c] =
          0.5 * (turned[3 * r + c] + turned[3 * c + r]) + variance * noise[3 * r + c];
    }
  }
  MatrixProduct3(inverse, rotation_by_gyro_.data(), block);
  for (int i = 0; i < 9; ++i) rotation_by_gyro_[i] = block[i] - dt * by_bias[i];
}

std::array<double, 81> Preintegration::covariance() const {
  std::array<double, 81> out;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 9; ++c) {
      out[9 * r + c] = of_rotation_[9 * r + c];
      out[9 * c + r] = of_rotation_[9 * r + c];
    }
    for (int c = 0; c < 3; ++c) {
      out[9 * (3 + r) + 3 + c] = of_position_[3 * r + c];
      out[9 * (3 + r) + 6 + c] = position_velocity_[3 * r + c];
      out[9 * (6 + c) + 3 + r] = position_velocity_[3 * r + c];
      out[9 * (6 + r) + 6 + c] = of_velocity_[3 * r + c];
    }
  }
  return out;
}

/// W = U^-1 of covariance = U U^T with U upper triangular: Cholesky's recursion from the last
/// column on. W^T W = U^-T U^-1.
void Preintegration::UpdateSqrtInformation() {
  constexpr int kSize = 9;
  constexpr double kSmallestPivot = 1e-14;  // beside the diagonal: rounding of the recursion
  const std::array<double, 81> covariance = this->covariance();
  std::array<double, 81> u = covariance;
  sqrt_information_.fill(0);
  has_information_ = false;
  for (int j = kSize - 1; j >= 0; --j) {
    double pivot = u[j * kSize + j];
    for (int k = j + 1; k < kSize; ++k) pivot -= u[j * kSize + k] * u[j * kSize + k];
    if (!(pivot > kSmallestPivot * covariance[j * kSize + j])) return;
    u[j * kSize + j] = std::sqrt(pivot);
    for (int i = 0; i < j; ++i) {
      double sum = u[i * kSize + j];
      for (int k = j + 1; k < kSize; ++k) sum -= u[i * kSize + k] * u[j * kSize + k];
      u[i * kSize + j] = sum / u[j * kSize + j];
    }
  }
  std::array<double, 81>& w = sqrt_information_;
  for (int j = 0; j < kSize; ++j) {
    w[j * kSize + j] = 1 / u[j * kSize + j];
    for (int i = j - 1; i >= 0; --i) {
      double sum = 0;
      for (int k = i + 1; k <= j; ++k) sum += u[i * kSize + k] * w[k * kSize + j];
      w[i * kSize + j] = -sum / u[i * kSize + i];
    }
  }
  has_information_ = true;
}

const std::array<double, 81>& Preintegration::sqrt_information() const {
  if (!has_information_) {
    throw InputError("preintegration: the covariance of " + std::to_string(samples_.size()) +
                     " samples is not positive definite: expected more of them, or an "
                     "integration_covariance above 0");
  }
  return sqrt_information_;
}

void Preintegration::Corrected(const double gyro_bias[3], const double accel_bias[3],
                               double rotation[9], double position[3], double velocity[3]) const {
  double gyro[3], accel[3], angle[3], turn[9], left_jacobian[9], by_gyro[3], by_accel[3];
  for (int i = 0; i < 3; ++i) {
    gyro[i] = gyro_bias[i] - gyro_bias_[i];
    accel[i] = accel_bias[i] - accel_bias_[i];
  }
  MatrixVector3(rotation_by_gyro_.data(), gyro, angle);
  ExpRotation(angle, turn, left_jacobian);
  MatrixProduct3(rotation_.data(), turn, rotation);
  MatrixVector3(position_by_gyro_.data(), gyro, by_gyro);
  MatrixVector3(position_by_accel_.data(), accel, by_accel);
  for (int i = 0; i < 3; ++i) position[i] = position_[i] + by_gyro[i] + by_accel[i];
  MatrixVector3(velocity_by_gyro_.data(), gyro, by_gyro);
  MatrixVector3(velocity_by_accel_.data(), accel, by_accel);
  for (int i = 0; i < 3; ++i) velocity[i] = velocity_[i] + by_gyro[i] + by_accel[i];
}

}  // namespace bundle
