/// Part of Preintegration (preintegration.h): the joint covariance of motion and biases.
///
/// preintegration.cpp assumes constant biases. A bias with a random walk of density s_b ends at b_j
/// = b_i + n, with covariance s_b^2 T I, and affects the motion meanwhile. In an interval, the
/// errors (t, dp, dv, dbg, dba) change by the shear and the turn of preintegration.cpp, and by the
/// biases,
///
///   t -= J_r dt dbg,      dp -= 1/2 M dt^2 dba,      dv -= M dt dba,
///
/// then the covariance of the biases grows by s_b^2 dt I. For C <- A C A^T, a transition A is
/// applied to the rows of C, C is transposed, and A is applied to its rows again.
///
/// GTSAM's PreintegratedCombinedMeasurements has the same structure with three differences: its
/// accelerometer bias comes before the gyroscope bias; its bias residual is b_i - b_j, so that the
/// blocks between motion and biases have the opposite sign; and its default integrates in the
/// tangent space of the first rotation.

#include <algorithm>
#include <utility>

#include "core/geometry/rotation.h"
#include "core/inertial/preintegration.h"

namespace bundle {

namespace {

constexpr int kErrors = 15;
constexpr int kRotationRow = 0, kPositionRow = 3, kVelocityRow = 6, kGyroRow = 9, kAccelRow = 12;

class CombinedErrors {
 public:
  explicit CombinedErrors(double* covariance) : c_(covariance) {}

  /// rows[to..to+2] += scale m rows[from..from+2]
  void Add(int to, double scale, const double* m, int from) {
    for (int column = 0; column < kErrors; ++column) {
      double v[3], moved[3];
      for (int i = 0; i < 3; ++i) v[i] = scale * At(from + i, column);
      MatrixVector3(m, v, moved);
      for (int i = 0; i < 3; ++i) At(to + i, column) += moved[i];
    }
  }

  /// rows[row..row+2] = m rows[row..row+2]
  void Multiply(int row, const double* m) {
    for (int column = 0; column < kErrors; ++column) {
      double v[3], moved[3];
      for (int i = 0; i < 3; ++i) v[i] = At(row + i, column);
      MatrixVector3(m, v, moved);
      for (int i = 0; i < 3; ++i) At(row + i, column) = moved[i];
    }
  }

  void Transpose() {
    for (int r = 0; r < kErrors; ++r) {
      for (int c = 0; c < r; ++c) std::swap(At(r, c), At(c, r));
    }
  }

  double& At(int row, int column) { return c_[kErrors * row + column]; }

 private:
  double* c_;
};

/// C <- A C A^T of the transition A of the rows, for a symmetric C.
template <typename Transition>
void Transform(CombinedErrors* errors, const Transition& transition) {
  transition();
  errors->Transpose();
  transition();
}

/// out = m m^T
void Square(const double* m, double* out) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[3 * r + c] = 0;
      for (int k = 0; k < 3; ++k) out[3 * r + c] += m[3 * r + k] * m[3 * c + k];
    }
  }
}

/// out = scale m [v]x
void ScaledTimesSkew(double scale, const double* m, const double* v, double* out) {
  double skew[9];
  Skew(v, skew);
  MatrixProduct3(m, skew, out);
  for (int i = 0; i < 9; ++i) out[i] *= scale;
}

}  // namespace

void Preintegration::CombinedCovariance(double out[225]) const {
  constexpr double kIdentity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  std::fill_n(out, kErrors * kErrors, 0.0);
  CombinedErrors errors(out);
  const bool midpoint = rule_ == IntegrationRule::kMidpoint;
  double rotation[9];
  std::copy(kIdentity, kIdentity + 9, rotation);
  for (const ImuSample& sample : samples_) {
    const double dt = sample.dt, half = 0.5 * dt;
    double angle[3], back[3], force[3], end[3];
    for (int i = 0; i < 3; ++i) {
      angle[i] = (sample.gyro[i] - gyro_bias_[i]) * dt;
      back[i] = -angle[i];
      force[i] = sample.accel[i] - accel_bias_[i];
      end[i] = sample.accel_end[i] - accel_bias_[i];
    }
    double turn[9], left_jacobian[9], inverse[9], right_jacobian[9], next[9], mean[9];
    ExpRotation(angle, turn, left_jacobian);
    ExpRotation(back, inverse, right_jacobian);
    MatrixProduct3(rotation, turn, next);
    for (int i = 0; i < 9; ++i) mean[i] = midpoint ? 0.5 * (rotation[i] + next[i]) : rotation[i];
    double at_start[9], at_end[9], gyro_noise[9];
    ScaledTimesSkew(midpoint ? -half : -dt, rotation, force, at_start);
    ScaledTimesSkew(-half, next, end, at_end);
    Square(right_jacobian, gyro_noise);

    Transform(&errors, [&] {
      errors.Add(kPositionRow, dt, kIdentity, kVelocityRow);
      errors.Add(kPositionRow, half, at_start, kRotationRow);
      errors.Add(kVelocityRow, 1, at_start, kRotationRow);
      errors.Multiply(kRotationRow, inverse);
      errors.Add(kRotationRow, -dt, right_jacobian, kGyroRow);
    });
    const auto variance = [dt](double density) { return density * density * dt; };
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        errors.At(r, c) += variance(noise_.gyro_noise_density) * gyro_noise[3 * r + c];
      }
    }
    Transform(&errors, [&] {
      if (midpoint) {
        errors.Add(kPositionRow, half, at_end, kRotationRow);
        errors.Add(kVelocityRow, 1, at_end, kRotationRow);
      }
      errors.Add(kPositionRow, -half * dt, mean, kAccelRow);
      errors.Add(kVelocityRow, -dt, mean, kAccelRow);
    });
    const double of_accel = variance(noise_.accel_noise_density);
    for (int r = 0; r < 3; ++r) {
      const int p = kPositionRow + r, v = kVelocityRow + r;
      errors.At(p, p) += half * half * of_accel + noise_.integration_covariance * dt;
      errors.At(p, v) += half * of_accel;
      errors.At(v, p) += half * of_accel;
      errors.At(v, v) += of_accel;
      errors.At(kGyroRow + r, kGyroRow + r) += variance(noise_.gyro_bias_random_walk);
      errors.At(kAccelRow + r, kAccelRow + r) += variance(noise_.accel_bias_random_walk);
    }
    std::copy(next, next + 9, rotation);
  }
}

}  // namespace bundle
