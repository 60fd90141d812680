#include "core/inertial/preintegration.h"

/// Preintegration on the manifold (Forster, Carlone, Dellaert, Scaramuzza, "On-Manifold
/// Preintegration for Real-Time Visual-Inertial Odometry", TRO 2017).
///
/// A gyroscope measures w~ = w + bg + noise, an accelerometer f~ = R^T (a - g) + ba + noise, with R
/// = world_from_imu. With w = w~ - bg, f = f~ - ba, and H = dR times a force, an interval dt
/// changes the motion, relative to the frame at the start and without gravity, by
///
///   p += v dt + 1/2 dR f dt^2,      v += dR f dt,      dR <- dR E,      E = Exp(w dt),
///
/// in this order: the position uses the velocity and the rotation at the start of the interval. By
/// midpoint, the force is 1/2 (dR f + dR E f') with f' at the end of the interval, and w~ is the
/// mean of both ends.
///
/// Errors are taken in the frame of the start: Exp(t) dR, p and v of errors (t, dp, dv). Then no
/// turn changes t, and a force g = dR f of that frame changes by t x g. With k = -g dt (by midpoint
/// two of them: k0 = -1/2 dR f dt and k1 = -1/2 dR E f' dt), an interval is
///
///   a shear    dp += drift dv + 1/2 dt k x t,     dv += k x t,      drift = dt (or 0 for k1),
///   a turn     t -= dR J_l dt dbg,
///
/// and by midpoint a shear with k1. The turn comes from dR Exp((w - dbg) dt), which is dR Exp(-J_l
/// dt dbg) E = Exp(-dR J_l dt dbg) dR E to first order, J_l = J_l(w dt).
///
/// The Jacobians by the gyroscope's bias are three columns (J_t, J_p, J_v) of such errors. Those by
/// the accelerometer's bias change by -1/2 M dt^2 and -M dt with M = dR, or 1/2 (dR + dR E).
/// Outputs refer to the error of dR Exp(t): J_R = dR^T J_t, and the same for the covariance.
///
/// Covariance. The mean of white noise of density s over dt has the variance s^2 / dt. The noise of
/// the gyroscope adds with the turn s^2 dt times dR J_l J_l^T dR^T = I + (2c - b^2 - c^2 a^2)
/// [u]x^2, where J_l = I + b W + c W^2, u = dR w dt, a = |u|. The noise of the accelerometer is
/// that of a mean force, which is the same in any frame: s^2 (dt^3/4, dt^2/2, dt) I for (pp, pv,
/// vv). A third term, integration_covariance dt I, is added to the position. The blocks of A C A^T
/// for a shear follow with Y = [k]x (C_tt C_tp C_tv) = (X U V), Z = X [k]x^T:
///
///   tp += drift tv + 1/2 dt X^T        pp += drift (pv + pv^T) + drift^2 vv + 1/2 dt (U + U^T)
///   tv += X^T                                + 1/2 dt drift (V + V^T) + 1/4 dt^2 Z
///   vv += V + V^T + Z                  pv += drift vv + 1/2 dt V + U^T + drift V^T + 1/2 dt Z

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "core/error.h"
#include "core/geometry/rotation.h"

namespace bundle {

namespace {

/// out = [k]x m, of 3 x kColumns
template <int kColumns>
void CrossColumns(const double* k, const double* m, double* out) {
  const double x = k[0], y = k[1], z = k[2];
  for (int c = 0; c < kColumns; ++c) {
    const double a = m[c], b = m[kColumns + c], d = m[2 * kColumns + c];
    out[c] = y * d - z * b;
    out[kColumns + c] = z * a - x * d;
    out[2 * kColumns + c] = x * b - y * a;
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

void CheckSamples(const double* gyro, const double* accel, const double* dt, int count,
                  IntegrationRule rule) {
  const int rows = count + (rule == IntegrationRule::kMidpoint && count > 0 ? 1 : 0);
  RequireFinite("gyro", gyro, 3 * rows, 3);
  RequireFinite("accel", accel, 3 * rows, 3);
  for (int k = 0; k < count; ++k) {
    if (dt[k] > 0 && std::isfinite(dt[k])) continue;
    throw InputError("dt[" + std::to_string(k) + "]: expected a time above 0 s, found " +
                     std::to_string(dt[k]));
  }
}

void Preintegration::Integrate(const double* gyro, const double* accel, const double* dt,
                               int count) {
  const bool midpoint = rule_ == IntegrationRule::kMidpoint;
  CheckSamples(gyro, accel, dt, count, rule_);
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
  Finish();
}

void Preintegration::Append(const Preintegration& next) {
  if (next.rule_ != rule_) {
    throw InputError("append: expected samples of the same integration rule");
  }
  Append(std::vector<ImuSample>(next.samples_));  // a copy: `next` may be *this
}

void Preintegration::Append(const std::vector<ImuSample>& samples) {
  samples_.insert(samples_.end(), samples.begin(), samples.end());
  for (const ImuSample& sample : samples) Add(sample);
  Finish();
}

Preintegration Preintegration::Repropagated(const double gyro_bias[3],
                                            const double accel_bias[3]) const {
  Preintegration out(noise_, gyro_bias, accel_bias, rule_);
  out.Append(samples_);
  return out;
}

/// One interval.
void Preintegration::Add(const ImuSample& sample) {
  const double dt = sample.dt, half = 0.5 * dt;
  double angle[3], force[3];
  for (int i = 0; i < 3; ++i) {
    angle[i] = (sample.gyro[i] - gyro_bias_[i]) * dt;
    force[i] = sample.accel[i] - accel_bias_[i];
  }
  const double angle_squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2];
  const RotationCoefficients k = ExpCoefficients(angle_squared);
  double turn[9], left_jacobian[9], by_bias[9], rotation[9], mean_rotation[9];
  SkewPolynomial(angle, k.a, k.b, turn);
  SkewPolynomial(angle, k.b, k.c, left_jacobian);
  MatrixProduct3(rotation_.data(), turn, rotation);
  MatrixProduct3(rotation_.data(), left_jacobian, by_bias);

  double start_force[3], shear[3];
  MatrixVector3(rotation_.data(), force, start_force);
  const bool midpoint = rule_ == IntegrationRule::kMidpoint;
  const double share = midpoint ? 0.5 : 1;
  for (int i = 0; i < 3; ++i) shear[i] = -share * dt * start_force[i];
  Shear(shear, half, dt);

  const double gyro_variance = noise_.gyro_noise_density * noise_.gyro_noise_density * dt;
  double noise[9], start_angle[3];
  MatrixVector3(rotation_.data(), angle, start_angle);
  SkewPolynomial(start_angle, 0.0, 2 * k.c - k.b * k.b - k.c * k.c * angle_squared, noise);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) of_rotation_[9 * r + c] += gyro_variance * noise[3 * r + c];
  }
  for (int i = 0; i < 9; ++i) turn_by_gyro_[i] -= dt * by_bias[i];

  std::copy(rotation_.begin(), rotation_.end(), mean_rotation);
  if (midpoint) {
    double end[3], end_force[3];
    for (int i = 0; i < 3; ++i) end[i] = sample.accel_end[i] - accel_bias_[i];
    MatrixVector3(rotation, end, end_force);
    for (int i = 0; i < 3; ++i) shear[i] = -half * end_force[i];
    Shear(shear, half, 0);
    for (int i = 0; i < 3; ++i) start_force[i] = 0.5 * (start_force[i] + end_force[i]);
    for (int i = 0; i < 9; ++i) mean_rotation[i] = 0.5 * (rotation_[i] + rotation[i]);
  }

  const double accel_variance = noise_.accel_noise_density * noise_.accel_noise_density * dt;
  const double position_variance =
      half * half * accel_variance + noise_.integration_covariance * dt;
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
    position_[i] += dt * (velocity_[i] + half * start_force[i]);
    velocity_[i] += dt * start_force[i];
  }
  std::copy(rotation, rotation + 9, rotation_.begin());
  duration_ += dt;
  turned_ += std::sqrt(angle_squared);
}

/// Applies the shear of the derivation above, with this k.
void Preintegration::Shear(const double k[3], double half_dt, double drift) {
  double y[27], x[9], z[9], by_gyro[9];
  CrossColumns<9>(k, of_rotation_.data(), y);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) x[3 * c + r] = y[9 * r + c];  // X^T
  }
  CrossColumns<3>(k, x, z);
  CrossColumns<3>(k, turn_by_gyro_.data(), by_gyro);
  const double* u = y + 3;  // rows of nine numbers
  const double* v = y + 6;
  const Matrix pv = position_velocity_, vv = of_velocity_;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const int i = 3 * r + c, i9 = 9 * r + c, t = 3 * c + r, t9 = 9 * c + r;
      of_position_[i] += drift * (pv[i] + pv[t] + drift * vv[i]) +
                         half_dt * (u[i9] + u[t9] + drift * (v[i9] + v[t9]) + half_dt * z[i]);
      position_velocity_[i] += drift * (vv[i] + v[t9]) + half_dt * (v[i9] + z[i]) + u[t9];
      of_velocity_[i] += v[i9] + v[t9] + z[i];
      of_rotation_[i9 + 3] += drift * of_rotation_[i9 + 6] + half_dt * x[i];
      of_rotation_[i9 + 6] += x[i];
      position_by_gyro_[i] += drift * velocity_by_gyro_[i] + half_dt * by_gyro[i];
      velocity_by_gyro_[i] += by_gyro[i];
    }
  }
}

/// The covariance, by the error of dR Exp(t).
std::array<double, 81> Preintegration::covariance() const {
  std::array<double, 81> out;
  double blocks[3][9];  // of the rotation's rows
  for (int block = 0; block < 3; ++block) {
    double start[9];
    for (int i = 0; i < 9; ++i) start[i] = of_rotation_[9 * (i / 3) + 3 * block + i % 3];
    TransposedProduct3(rotation_.data(), start, blocks[block]);
  }
  double turned[9];
  MatrixProduct3(blocks[0], rotation_.data(), turned);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const int i = 3 * r + c, t = 3 * c + r;
      out[9 * r + c] = 0.5 * (turned[i] + turned[t]);
      out[9 * r + 3 + c] = out[9 * (3 + c) + r] = blocks[1][i];
      out[9 * r + 6 + c] = out[9 * (6 + c) + r] = blocks[2][i];
      out[9 * (3 + r) + 3 + c] = 0.5 * (of_position_[i] + of_position_[t]);
      out[9 * (3 + r) + 6 + c] = out[9 * (6 + c) + 3 + r] = position_velocity_[i];
      out[9 * (6 + r) + 6 + c] = 0.5 * (of_velocity_[i] + of_velocity_[t]);
    }
  }
  return out;
}

/// J_R, and W = U^-1 of covariance = U U^T with U upper triangular: Cholesky's recursion from the
/// last column on. W^T W = U^-T U^-1.
void Preintegration::Finish() {
  TransposedProduct3(rotation_.data(), turn_by_gyro_.data(), rotation_by_gyro_.data());
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
                     " samples is not positive definite: expected more samples, or an "
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
