#include "core/factors/imu_factor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "core/error.h"
#include "core/inertial/propagation.h"
#include "support/derivatives.h"

namespace bundle {
namespace {

constexpr double kZero[3] = {0, 0, 0};
constexpr double kStart[16] = {0.1, -0.2, 0.3, 0.9, 1, 2, 3, 0.5, -0.3, 0.2, 0, 0, 0, 0, 0, 0};

std::shared_ptr<const Preintegration> ShortMotion() {
  auto motion =
      std::make_shared<Preintegration>(ImuNoise{1.7e-4, 2e-3, 2e-5, 3e-3, 1e-8}, kZero, kZero);
  std::vector<double> gyro, accel;
  for (int k = 0; k < 20; ++k) {
    gyro.insert(gyro.end(), {std::sin(k), 0.5 * std::cos(k), 1.0});
    accel.insert(accel.end(), {2 * std::cos(k), 1.0, 9.81 + std::sin(2 * k)});
  }
  const std::vector<double> dt(20, 0.01);
  motion->Integrate(gyro.data(), accel.data(), dt.data(), 20);
  return motion;
}

std::vector<std::vector<double>> ValuesAround(const Preintegration& motion) {
  double end[16];
  constexpr double kGravity[3] = {0, 0, -9.81};
  PredictState(motion, kStart, kGravity, end);
  std::vector<std::vector<double>> values = {{kStart, kStart + 7},
                                             {kStart + 7, kStart + 10},
                                             {0.01, 0, -0.02, 0.1, 0.2, 0},
                                             {end, end + 7},
                                             {end + 7, end + 10}};
  values[3][0] += 0.05;
  values[3][5] += 0.1;
  values[4][1] -= 0.2;
  const Retraction pose(Manifold::kSe3, 7);
  for (const int b : {0, 3}) pose.Normalize(values[b].data());
  return values;
}

TEST(ImuFactor, JacobiansWithGravityAndScale) {
  const auto motion = ShortMotion();
  const std::vector<double> down = {0, 0, -9.81};
  auto values = ValuesAround(*motion);
  const FactorHead five{"factor 0", {0, 1, 2, 3, 4}}, six{"factor 0", {0, 1, 2, 3, 4, 5}};
  testing::ExpectDerivativesOf(ImuFactor(five, motion, down, nullptr, false), values);
  values.push_back({1.3});
  testing::ExpectDerivativesOf(ImuFactor(six, motion, down, nullptr, true), values);
  const Retraction vector(Manifold::kEuclidean, 3), turn(Manifold::kSo3, 4);
  values.back() = {0.5, -0.3, -9.6};
  testing::ExpectDerivativesOf(ImuFactor(six, motion, down, &vector, false), values);
  values.back() = {0.1, -0.1, 0, std::sqrt(0.98)};
  const std::vector<double> slanted = {1, -2, -9};
  testing::ExpectDerivativesOf(ImuFactor(six, motion, slanted, &turn, false), values);
  values.push_back({0.7});
  const FactorHead seven{"factor 0", {0, 1, 2, 3, 4, 5, 6}};
  testing::ExpectDerivativesOf(ImuFactor(seven, motion, slanted, &turn, true), values);
}

TEST(ImuFactor, IsZeroAtTheStateThatTheMotionPredicts) {
  const auto motion = ShortMotion();
  double end[16], residual[9];
  constexpr double kGravity[3] = {0, 0, -9.81};
  PredictState(*motion, kStart, kGravity, end);
  const double bias[6] = {};
  const double* const values[] = {kStart, kStart + 7, bias, end, end + 7};
  const ImuFactor factor({"factor 0", {0, 1, 2, 3, 4}}, motion, {0, 0, -9.81}, nullptr, false);
  ASSERT_TRUE(factor.Evaluate(values, residual, nullptr));
  for (const double r : residual) EXPECT_NEAR(r, 0, 1e-7);  // in sigmas
}

TEST(ImuFactor, RefusesAMotionWithoutInformation) {
  const auto empty =
      std::make_shared<Preintegration>(ImuNoise{1.7e-4, 2e-3, 2e-5, 3e-3, 1e-8}, kZero, kZero);
  const FactorHead head{"factor 0", {0, 1, 2, 3, 4}};
  EXPECT_THROW(ImuFactor(head, empty, {0, 0, -9.81}, nullptr, false), InputError);
  EXPECT_THROW(ImuFactor(head, ShortMotion(), {0, 0}, nullptr, false), InputError);
}

}  // namespace
}  // namespace bundle
