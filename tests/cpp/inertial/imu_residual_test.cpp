#include "core/inertial/imu_residual.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "core/ceres/gradient_check.h"
#include "core/error.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

constexpr ImuNoise kNoise = {1.7e-4, 2e-3, 2e-5, 3e-3, 1e-8};
constexpr double kNone[3] = {0, 0, 0};

std::vector<double> Random(int count, double scale, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<double> out(count);
  for (double& value : out) value = scale * normal(*random);
  return out;
}

/// `count` intervals of a fast motion, biases taken from it.
Preintegration RandomMotion(IntegrationRule rule, int count, const double gyro_bias[3],
                            const double accel_bias[3]) {
  std::mt19937_64 random(count);
  const std::vector<double> gyro = Random(3 * count + 3, 1.5, &random);
  const std::vector<double> accel = Random(3 * count + 3, 6, &random);
  std::vector<double> dt(count);
  for (int k = 0; k < count; ++k) dt[k] = 0.005 * (1 + k % 3);
  Preintegration motion(kNoise, gyro_bias, accel_bias, rule);
  motion.Integrate(gyro.data(), accel.data(), dt.data(), count);
  return motion;
}

/// A function of `sizes` against its Jacobians, side by side in each row.
void ExpectDerivatives(const std::vector<int>& sizes, int num_residuals,
                       const ResidualFunction& function, const std::vector<double>& jacobian) {
  FunctionAtPoint at;
  at.num_residuals = num_residuals;
  for (const int size : sizes) {
    at.blocks.emplace_back(size, 0.0);
    at.manifolds.push_back({"euclidean", {}});
  }
  at.function = function;
  const ReferenceJacobians reference = DifferentiateByRichardson(at);
  ASSERT_EQ(jacobian.size(), reference.ambient.values.size());
  for (size_t i = 0; i < jacobian.size(); ++i) {
    EXPECT_NEAR(jacobian[i], reference.ambient.values[i], 1e-7 * (1 + std::abs(jacobian[i]))) << i;
  }
}

class BothRules : public testing::TestWithParam<IntegrationRule> {};

TEST_P(BothRules, BiasJacobiansAreDerivativesOfRepropagation) {
  const double gyro_bias[3] = {0.02, -0.03, 0.01}, accel_bias[3] = {0.1, 0.2, -0.3};
  const Preintegration motion = RandomMotion(GetParam(), 40, gyro_bias, accel_bias);
  const auto function = [&](double const* const* steps, double* out, double** /*jacobians*/) {
    double gyro[3], accel[3], inverse[9], turn[9];
    for (int i = 0; i < 3; ++i) {
      gyro[i] = gyro_bias[i] + steps[0][i];
      accel[i] = accel_bias[i] + steps[1][i];
    }
    const Preintegration again = motion.Repropagated(gyro, accel);
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) inverse[3 * c + r] = motion.delta_rotation()[3 * r + c];
    }
    MatrixProduct3(inverse, again.delta_rotation(), turn);
    out[0] = 0.5 * (turn[7] - turn[5]);  // the sine of a small turn
    out[1] = 0.5 * (turn[2] - turn[6]);
    out[2] = 0.5 * (turn[3] - turn[1]);
    std::copy(again.delta_position(), again.delta_position() + 3, out + 3);
    std::copy(again.delta_velocity(), again.delta_velocity() + 3, out + 6);
    return true;
  };
  constexpr double kZero[9] = {};
  const double* const blocks[3][2] = {
      {motion.d_rotation_d_gyro_bias(), kZero},
      {motion.d_position_d_gyro_bias(), motion.d_position_d_accel_bias()},
      {motion.d_velocity_d_gyro_bias(), motion.d_velocity_d_accel_bias()}};
  std::vector<double> jacobian;
  for (const auto& row_of_blocks : blocks) {
    for (int r = 0; r < 3; ++r) {
      for (const double* block : row_of_blocks) {
        jacobian.insert(jacobian.end(), block + 3 * r, block + 3 * r + 3);
      }
    }
  }
  ExpectDerivatives({3, 3}, 9, function, jacobian);
}

TEST_P(BothRules, ResidualHasItsJacobians) {
  std::mt19937_64 random(5);
  const Preintegration motion = RandomMotion(GetParam(), 30, kNone, kNone);
  std::vector<double> rows[2];
  for (std::vector<double>& row : rows) row = Random(16, 1, &random);
  for (int i = 10; i < 16; ++i) rows[0][i] *= 0.05;
  const std::vector<double> gravity = Random(3, 9.81, &random);
  const ImuState start[2] = {ImuStateFromRow(rows[0].data()), ImuStateFromRow(rows[1].data())};
  const auto moved = [&](int which, const double* step) {
    ImuState state = start[which];
    double turn[9], unused[9];
    ExpRotation(step, turn, unused);
    MatrixProduct3(start[which].rotation, turn, state.rotation);
    for (int i = 0; i < 3; ++i) {
      state.position[i] += step[3 + i];
      state.velocity[i] += step[6 + i];
      state.gyro_bias[i] += step[9 + i];
      state.accel_bias[i] += step[12 + i];
    }
    return state;
  };
  const auto function = [&](double const* const* steps, double* out, double** /*jacobians*/) {
    double g[3];
    for (int i = 0; i < 3; ++i) g[i] = gravity[i] + steps[2][i];
    ImuResidual(motion, moved(0, steps[0]), moved(1, steps[1]), g, out, nullptr, nullptr, nullptr);
    return true;
  };
  double residual[9], by_i[9 * 15], by_j[9 * 15], by_gravity[9 * 3];
  ImuResidual(motion, start[0], start[1], gravity.data(), residual, by_i, by_j, by_gravity);
  std::vector<double> jacobian;
  for (int r = 0; r < 9; ++r) {
    jacobian.insert(jacobian.end(), by_i + 15 * r, by_i + 15 * r + 15);
    jacobian.insert(jacobian.end(), by_j + 15 * r, by_j + 15 * r + 15);
    jacobian.insert(jacobian.end(), by_gravity + 3 * r, by_gravity + 3 * r + 3);
  }
  ExpectDerivatives({15, 15, 3}, 9, function, jacobian);
}

TEST_P(BothRules, CombinedCovarianceWithoutWalksIsTheOther) {
  const Preintegration walking = RandomMotion(GetParam(), 25, kNone, kNone);
  ImuNoise noise = kNoise;
  noise.gyro_bias_random_walk = noise.accel_bias_random_walk = 0;
  Preintegration still(noise, kNone, kNone, GetParam());
  still.Append(walking);
  double combined[225];
  still.CombinedCovariance(combined);
  const std::array<double, 81> covariance = still.covariance();
  for (int r = 0; r < 15; ++r) {
    for (int c = 0; c < 15; ++c) {
      const double expected = r < 9 && c < 9 ? covariance[9 * r + c] : 0;
      EXPECT_NEAR(combined[15 * r + c], expected, 1e-13 * covariance[80]) << r << " " << c;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Preintegration, BothRules,
                         testing::Values(IntegrationRule::kZeroOrderHold,
                                         IntegrationRule::kMidpoint));

TEST(Preintegration, SquareRootWhitensTheCovariance) {
  const Preintegration motion = RandomMotion(IntegrationRule::kZeroOrderHold, 20, kNone, kNone);
  std::vector<double> m(81, 0.0);
  for (int i = 0; i < 9; ++i) m[10 * i] = 1;
  WhitenImu(motion, m.data(), 9);  // W
  const std::array<double, 81> covariance = motion.covariance();
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 9; ++c) {
      EXPECT_TRUE(c >= r || m[9 * r + c] == 0);
      double sum = 0;
      for (int k = 0; k < 9; ++k) {
        for (int l = 0; l < 9; ++l) sum += m[9 * r + k] * covariance[9 * k + l] * m[9 * c + l];
      }
      EXPECT_NEAR(sum, r == c ? 1 : 0, 1e-9);
    }
  }
}

TEST(Preintegration, AppendContinuesAtTheFirstBiases) {
  const double bias[3] = {0.1, 0.2, 0.3};
  const Preintegration whole = RandomMotion(IntegrationRule::kMidpoint, 12, kNone, kNone);
  Preintegration first(kNoise, kNone, kNone, IntegrationRule::kMidpoint);
  Preintegration second(kNoise, bias, bias, IntegrationRule::kMidpoint);
  for (int k = 0; k < 12; ++k) {
    const ImuSample& sample = whole.samples()[k];
    double gyro[6], accel[6];
    for (int i = 0; i < 3; ++i) {
      gyro[i] = gyro[3 + i] = sample.gyro[i];
      accel[i] = sample.accel[i];
      accel[3 + i] = sample.accel_end[i];
    }
    (k < 5 ? first : second).Integrate(gyro, accel, &sample.dt, 1);
  }
  first.Append(second);
  EXPECT_EQ(first.samples().size(), 12);
  EXPECT_DOUBLE_EQ(first.duration(), whole.duration());
  EXPECT_DOUBLE_EQ(first.turned(), whole.turned());
  for (int i = 0; i < 3; ++i) EXPECT_EQ(first.delta_position()[i], whole.delta_position()[i]);
  EXPECT_EQ(first.covariance(), whole.covariance());
  EXPECT_EQ(first.sqrt_information(), whole.sqrt_information());
  EXPECT_THROW(first.Append(RandomMotion(IntegrationRule::kZeroOrderHold, 1, kNone, kNone)),
               InputError);
}

TEST(Preintegration, RefusesWhatIsNoMeasurement) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double good[6] = {1, 2, 3, 4, 5, 6}, bad[6] = {1, 2, 3, 4, nan, 6};
  const double dt[2] = {0.01, 0.01}, back[2] = {0.01, -0.01}, none[2] = {0.01, 0},
               gap[2] = {nan, 1};
  Preintegration motion(kNoise, kNone, kNone);
  EXPECT_THROW(motion.Integrate(bad, good, dt, 2), InputError);
  EXPECT_THROW(motion.Integrate(good, bad, dt, 2), InputError);
  EXPECT_THROW(motion.Integrate(good, good, back, 2), InputError);
  EXPECT_THROW(motion.Integrate(good, good, none, 2), InputError);
  EXPECT_THROW(motion.Integrate(good, good, gap, 2), InputError);
  EXPECT_EQ(motion.samples().size(), 0);
  EXPECT_EQ(motion.duration(), 0);
  EXPECT_THROW(motion.sqrt_information(), InputError);
  ImuNoise exact = kNoise;
  exact.integration_covariance = 0;
  Preintegration one(exact, kNone, kNone);
  one.Integrate(good, good, dt, 1);  // position and velocity have one error
  EXPECT_THROW(one.sqrt_information(), InputError);
  exact.gyro_noise_density = 0;
  EXPECT_THROW(Preintegration(exact, kNone, kNone), InputError);
  const double infinite[3] = {0, 1 / 0.0, 0};
  EXPECT_THROW(Preintegration(kNoise, infinite, kNone), InputError);
  EXPECT_THROW(Preintegration(kNoise, kNone, infinite), InputError);
}

}  // namespace
}  // namespace bundle
