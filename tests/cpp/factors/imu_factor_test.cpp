#include "core/factors/imu_factor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "core/ceres/gradient_check.h"
#include "core/error.h"
#include "core/inertial/propagation.h"

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

/// All Jacobians against Ridders' extrapolation, in units of the largest entry.
void ExpectDerivativesOf(const Factor& factor, const std::vector<std::vector<double>>& values) {
  std::vector<std::vector<double>> given;
  std::vector<const double*> pointers;
  std::vector<double*> blocks;
  FunctionAtPoint at;
  at.num_residuals = factor.num_residuals();
  int columns = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    given.emplace_back(factor.num_residuals() * size);
    at.blocks.emplace_back(size, 0.0);
    at.manifolds.push_back({"euclidean", {}});
    pointers.push_back(values[b].data());
    columns += size;
  }
  for (std::vector<double>& block : given) blocks.push_back(block.data());
  at.function = [&](double const* const* steps, double* residual, double** /*jacobians*/) {
    std::vector<std::vector<double>> moved = values;
    std::vector<const double*> there;
    for (size_t b = 0; b < moved.size(); ++b) {
      factor.retractions()[b].Plus(values[b].data(), steps[b], moved[b].data());
      there.push_back(moved[b].data());
    }
    return factor.Evaluate(there.data(), residual, nullptr);
  };
  std::vector<double> residual(factor.num_residuals());
  ASSERT_TRUE(factor.Evaluate(pointers.data(), residual.data(), blocks.data()));
  const ReferenceJacobians reference = DifferentiateByRichardson(at);
  double scale = 0;
  for (const double value : reference.ambient.values) scale = std::max(scale, std::abs(value));
  int first = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    for (int r = 0; r < factor.num_residuals(); ++r) {
      for (int c = 0; c < size; ++c) {
        EXPECT_NEAR(given[b][r * size + c], reference.ambient.values[r * columns + first + c],
                    1e-6 * scale)
            << "block " << b << " row " << r << " column " << c;
      }
    }
    first += size;
  }
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
  ExpectDerivativesOf(ImuFactor(five, motion, down, nullptr, false), values);
  values.push_back({1.3});
  ExpectDerivativesOf(ImuFactor(six, motion, down, nullptr, true), values);
  const Retraction vector(Manifold::kEuclidean, 3), turn(Manifold::kSo3, 4);
  values.back() = {0.5, -0.3, -9.6};
  ExpectDerivativesOf(ImuFactor(six, motion, down, &vector, false), values);
  values.back() = {0.1, -0.1, 0, std::sqrt(0.98)};
  const std::vector<double> slanted = {1, -2, -9};
  ExpectDerivativesOf(ImuFactor(six, motion, slanted, &turn, false), values);
  values.push_back({0.7});
  const FactorHead seven{"factor 0", {0, 1, 2, 3, 4, 5, 6}};
  ExpectDerivativesOf(ImuFactor(seven, motion, slanted, &turn, true), values);
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
