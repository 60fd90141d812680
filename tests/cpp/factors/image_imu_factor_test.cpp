#include "core/factors/image_imu_factor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/error.h"
#include "core/geometry/rotation.h"
#include "support/derivatives.h"

namespace bundle {
namespace {

constexpr double kNoBias[3] = {0, 0, 0};
constexpr double kDownwards[3] = {0, 0, -9.81};
const FactorHead kHead{"factor 0", {0, 1, 2, 3, 4, 5}};
const std::vector<double> kDown(kDownwards, kDownwards + 3);

std::vector<double> Pose(std::vector<double> value) {
  Retraction(Manifold::kSe3, 7).Normalize(value.data());
  return value;
}

/// x as a function of time: rates and specific forces of an IMU that turns about a slanted axis and
/// swings, integrated by many small steps of the definition of velocity and rotation.
struct Flight {
  double rotation[9], position[3] = {1, 2, 3}, velocity[3] = {0.5, -0.3, 0.2};

  Flight() {
    const double turn[3] = {0.3, -0.5, 0.8};
    double left_jacobian[9];
    ExpRotation(turn, rotation, left_jacobian);
  }

  static void Rate(double t, double* rate) {
    rate[0] = std::sin(3 * t);
    rate[1] = 0.5 * std::cos(2 * t);
    rate[2] = 1.0;
  }
  static void Force(double t, double* force) {
    force[0] = 2 * std::cos(5 * t);
    force[1] = 1.0;
    force[2] = 9.81 + std::sin(4 * t);
  }

  /// Moves to the time t + step with the values in the middle.
  void Move(double t, double step) {
    double rate[3], force[3], half[3], whole[3], turn[9], turned[9], left_jacobian[9], world[3];
    Rate(t + step / 2, rate);
    Force(t + step / 2, force);
    for (int i = 0; i < 3; ++i) half[i] = rate[i] * step / 2;
    for (int i = 0; i < 3; ++i) whole[i] = rate[i] * step;
    ExpRotation(half, turn, left_jacobian);
    MatrixProduct3(rotation, turn, turned);
    MatrixVector3(turned, force, world);
    for (int i = 0; i < 3; ++i) {
      const double acceleration = world[i] + kDownwards[i];
      position[i] += velocity[i] * step + acceleration * step * step / 2;
      velocity[i] += acceleration * step;
    }
    ExpRotation(whole, turn, left_jacobian);
    MatrixProduct3(rotation, turn, turned);
    std::copy_n(turned, 9, rotation);
  }

  /// cam_from_world of a camera on the IMU: E Y^-1, by matrices.
  std::vector<double> Camera(const std::vector<double>& camera_from_imu) const {
    double arm[9], back[9], out[9], moved[3];
    QuaternionToRotation(camera_from_imu.data(), arm);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) back[3 * i + j] = rotation[3 * j + i];
    }
    MatrixProduct3(arm, back, out);
    MatrixVector3(out, position, moved);
    std::vector<double> pose(7);
    QuaternionFromRotation(out, pose.data());
    for (int i = 0; i < 3; ++i) pose[4 + i] = camera_from_imu[4 + i] - moved[i];
    return pose;
  }
};

constexpr int kSamples = 100;
constexpr double kInterval = 0.002;

std::shared_ptr<const Preintegration> Motion(const double* gyro_bias, const double* accel_bias) {
  auto motion = std::make_shared<Preintegration>(ImuNoise{1.7e-4, 2e-3, 2e-5, 3e-3, 1e-8}, kNoBias,
                                                 kNoBias, IntegrationRule::kMidpoint);
  std::vector<double> gyro(3 * (kSamples + 1)), accel(gyro.size());
  for (int k = 0; k <= kSamples; ++k) {
    Flight::Rate(k * kInterval, &gyro[3 * k]);
    Flight::Force(k * kInterval, &accel[3 * k]);
    for (int i = 0; i < 3; ++i) {
      gyro[3 * k + i] += gyro_bias[i];
      accel[3 * k + i] += accel_bias[i];
    }
  }
  const std::vector<double> dt(kSamples, kInterval);
  motion->Integrate(gyro.data(), accel.data(), dt.data(), kSamples);
  return motion;
}

const std::vector<double> kCameraFromImu = Pose({0.4, -0.3, 0.2, 0.7, 0.1, -0.2, 0.3});

std::vector<std::vector<double>> TrueValues(const std::vector<double>& gyro_bias,
                                            const std::vector<double>& accel_bias) {
  Flight flight;
  std::vector<std::vector<double>> values = {
      flight.Camera(kCameraFromImu), {flight.velocity, flight.velocity + 3}, gyro_bias, accel_bias};
  constexpr int kFine = 50;
  constexpr double kStep = kInterval / kFine;
  for (int k = 0; k < kSamples * kFine; ++k) flight.Move(k * kStep, kStep);
  values.push_back(flight.Camera(kCameraFromImu));
  values.emplace_back(flight.velocity, flight.velocity + 3);
  return values;
}

std::vector<const double*> Pointers(const std::vector<std::vector<double>>& values) {
  std::vector<const double*> pointers;
  for (const std::vector<double>& value : values) pointers.push_back(value.data());
  return pointers;
}

TEST(ImageImuFactor, IsZeroAlongAMotionOfTheCamera) {
  // Biases are small: motions are of first order in them.
  const std::vector<double> gyro_bias = {1e-5, -2e-5, 1e-5}, accel_bias = {1e-3, 2e-3, -1e-3};
  const auto motion = Motion(gyro_bias.data(), accel_bias.data());
  const ImageImuFactor factor(kHead, motion, kDown, kCameraFromImu);
  auto values = TrueValues(gyro_bias, accel_bias);
  double residual[9];
  ASSERT_TRUE(factor.Evaluate(Pointers(values).data(), residual, nullptr));
  for (const double r : residual) EXPECT_NEAR(r, 0, 0.05);  // in sigmas
  // One sigma of the velocity after 0.2 s is about 1e-3 m/s.
  values[5][0] += 0.1;
  ASSERT_TRUE(factor.Evaluate(Pointers(values).data(), residual, nullptr));
  double largest = 0;
  for (const double r : residual) largest = std::max(largest, std::abs(r));
  EXPECT_GT(largest, 10);
}

TEST(ImageImuFactor, JacobiansAwayFromTheMotion) {
  auto values = TrueValues({0.01, 0, -0.02}, {0.1, 0.2, 0});
  values[4] = Pose({values[4][0] + 0.05, values[4][1], values[4][2], values[4][3], values[4][4],
                    values[4][5] + 0.1, values[4][6]});
  values[5][1] -= 0.2;
  testing::ExpectDerivativesOf(
      ImageImuFactor(kHead, Motion(kNoBias, kNoBias), kDown, kCameraFromImu), values);
}

TEST(ImageImuFactor, LeavesOutJacobiansThatAreNotWanted) {
  const auto values = TrueValues({0.01, 0, -0.02}, {0.1, 0.2, 0});
  const ImageImuFactor factor(kHead, Motion(kNoBias, kNoBias), kDown, kCameraFromImu);
  const int sizes[] = {6, 3, 3, 3, 6, 3};
  double residual[9];
  std::vector<std::vector<double>> all;
  std::vector<double*> blocks;
  for (const int size : sizes) all.emplace_back(9 * size);
  for (std::vector<double>& block : all) blocks.push_back(block.data());
  ASSERT_TRUE(factor.Evaluate(Pointers(values).data(), residual, blocks.data()));
  for (int b = 0; b < 6; ++b) {
    std::vector<double> block(all[b].size());
    double* only[6] = {};
    only[b] = block.data();
    ASSERT_TRUE(factor.Evaluate(Pointers(values).data(), residual, only));
    EXPECT_EQ(block, all[b]) << "block " << b;
  }
}

TEST(ImageImuFactor, RefusesWhatIsNoPose) {
  const auto motion = Motion(kNoBias, kNoBias);
  EXPECT_THROW(ImageImuFactor(kHead, motion, kDown, {0, 0, 0, 0, 1, 2, 3}), InputError);
  EXPECT_THROW(ImageImuFactor(kHead, motion, kDown, {0, 0, 0, 1}), InputError);
  EXPECT_THROW(ImageImuFactor(kHead, motion, {0, 0}, kCameraFromImu), InputError);
}

}  // namespace
}  // namespace bundle
