// Tests of all factors in one file, since they share one check of Jacobians.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "core/cameras/registry.h"
#include "core/ceres/gradient_check.h"
#include "core/error.h"
#include "core/factors/linear_prior.h"
#include "core/factors/measurement_factors.h"
#include "core/factors/twist_tie.h"
#include "core/factors/velocity_factor.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

using Values = std::vector<std::vector<double>>;

const Retraction kAll[] = {{Manifold::kEuclidean, 3},
                           {Manifold::kSo2, 1},
                           {Manifold::kSo3, 4},
                           {Manifold::kSe2, 3},
                           {Manifold::kSe3, 7}};

std::vector<double> RandomValue(const Retraction& retraction, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<double> x(retraction.ambient_size());
  for (double& value : x) value = normal(*random);
  retraction.Normalize(x.data());
  return x;
}

/// A value some way off, by less than a radian or so: differences are not to step over the cut at
/// pi.
std::vector<double> Near(const Retraction& retraction, const std::vector<double>& x,
                         std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<double> d(retraction.tangent_size()), y(x.size());
  for (double& value : d) value = std::clamp(0.5 * normal(*random), -0.7, 0.7);
  retraction.Plus(x.data(), d.data(), y.data());
  return y;
}

/// A A^T + 1/10, A random.
std::vector<double> RandomInformation(int n, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<double> a(n * n), information(n * n);
  for (double& value : a) value = normal(*random);
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < n; ++c) {
      information[r * n + c] = r == c ? 0.1 : 0;
      for (int k = 0; k < n; ++k) information[r * n + c] += a[r * n + k] * a[c * n + k];
    }
  }
  return information;
}

FactorHead Head(std::vector<int> blocks) { return {"factor 0", std::move(blocks)}; }

/// The residual and its Jacobians side by side, by tangent coordinates.
std::vector<double> Evaluate(const Factor& factor, const Values& values,
                             std::vector<double>* jacobian) {
  const int rows = factor.num_residuals();
  std::vector<double> residual(rows);
  std::vector<const double*> pointers;
  Values storage;
  int columns = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    pointers.push_back(values[b].data());
    storage.emplace_back(rows * factor.retractions()[b].tangent_size());
    columns += factor.retractions()[b].tangent_size();
  }
  std::vector<double*> jacobians;
  for (std::vector<double>& one : storage) jacobians.push_back(one.data());
  EXPECT_TRUE(factor.Evaluate(pointers.data(), residual.data(), jacobians.data()));
  if (jacobian == nullptr) return residual;
  jacobian->assign(rows * columns, 0.0);
  int first = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    for (int r = 0; r < rows; ++r) {
      for (int c = 0; c < size; ++c) {
        (*jacobian)[r * columns + first + c] = storage[b][r * size + c];
      }
    }
    first += size;
  }
  return residual;
}

/// Richardson's differences of the residual by steps X Exp(d) from the values. Their own error is
/// up to 1e-6 where a first step of about 1 comes close to the cut of a logarithm.
void ExpectJacobiansAreDerivatives(const Factor& factor, const Values& values) {
  FunctionAtPoint at;
  at.num_residuals = factor.num_residuals();
  for (const Retraction& retraction : factor.retractions()) {
    at.blocks.emplace_back(retraction.tangent_size(), 0.0);
    at.manifolds.push_back({"euclidean", {}});
  }
  at.function = [&](double const* const* steps, double* residual, double** /*jacobians*/) {
    Values moved = values;
    std::vector<const double*> pointers;
    for (size_t b = 0; b < moved.size(); ++b) {
      factor.retractions()[b].Plus(values[b].data(), steps[b], moved[b].data());
      pointers.push_back(moved[b].data());
    }
    return factor.Evaluate(pointers.data(), residual, nullptr);
  };
  const ReferenceJacobians reference = DifferentiateByRichardson(at);
  std::vector<double> jacobian;
  Evaluate(factor, values, &jacobian);
  ASSERT_EQ(jacobian.size(), reference.ambient.values.size());
  double scale = 0;
  for (const double value : jacobian) scale = std::max(scale, std::abs(value));
  for (size_t i = 0; i < jacobian.size(); ++i) {
    EXPECT_LT(reference.ambient.uncertainty[i], 1e-6 * scale);
    EXPECT_NEAR(jacobian[i], reference.ambient.values[i], 1e-5 * scale) << i;
  }
}

TEST(PriorFactor, JacobianOnEveryManifold) {
  std::mt19937_64 random(1);
  for (const Retraction& retraction : kAll) {
    const int n = retraction.tangent_size();
    const std::vector<double> value = RandomValue(retraction, &random);
    const PriorFactor factor(Head({0}), retraction, value, RandomInformation(n, &random));
    for (int repeat = 0; repeat < 5; ++repeat) {
      ExpectJacobiansAreDerivatives(factor, {Near(retraction, value, &random)});
    }
  }
}

TEST(ScalarPriorFactor, IsOfOneNumberOrOfItsLogarithm) {
  const Retraction camera(Manifold::kEuclidean, 3);
  const Values at = {{800, 300, -0.2}};
  const ScalarPriorFactor linear(Head({0}), camera, 0, 1000, 50, false);
  EXPECT_DOUBLE_EQ(Evaluate(linear, at, nullptr)[0], -4);
  ExpectJacobiansAreDerivatives(linear, at);
  const ScalarPriorFactor relative(Head({0}), camera, 0, 1000, 0.02, true);
  EXPECT_NEAR(Evaluate(relative, at, nullptr)[0], std::log(0.8) / 0.02, 1e-13);
  ExpectJacobiansAreDerivatives(relative, at);
  // Of a negative number: its share of the value is what counts.
  const ScalarPriorFactor negative(Head({0}), camera, 2, -0.1, 0.5, true);
  EXPECT_NEAR(Evaluate(negative, at, nullptr)[0], std::log(2) / 0.5, 1e-14);
  ExpectJacobiansAreDerivatives(negative, at);
  const double beyond[] = {800, 300, 0.2};
  const double* const values[] = {beyond};
  double residual = 0;
  EXPECT_FALSE(negative.Evaluate(values, &residual, nullptr));
}

TEST(ScalarPriorFactor, RefusesWhatIsNone) {
  const Retraction camera(Manifold::kEuclidean, 3);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(ScalarPriorFactor(Head({0}), {Manifold::kSe3, 7}, 0, 1, 1, false), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, 3, 1, 1, false), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, -1, 1, 1, false), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, 0, nan, 1, false), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, 0, 0, 1, true), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, 0, 1, 0, false), InputError);
  EXPECT_THROW(ScalarPriorFactor(Head({0}), camera, 0, 1, nan, false), InputError);
}

TEST(BetweenFactor, JacobiansOnEveryManifold) {
  std::mt19937_64 random(2);
  for (const Retraction& retraction : kAll) {
    for (int repeat = 0; repeat < 5; ++repeat) {
      const std::vector<double> a = RandomValue(retraction, &random);
      const std::vector<double> b = RandomValue(retraction, &random);
      std::vector<double> between(a.size());
      retraction.Between(a.data(), b.data(), between.data());
      const BetweenFactor factor(Head({0, 1}), retraction, Near(retraction, between, &random),
                                 RandomInformation(retraction.tangent_size(), &random));
      ExpectJacobiansAreDerivatives(factor, {a, b});
    }
  }
}

TEST(RelativePoseFactor, JacobiansAndTheFrameOfTheMeasurement) {
  std::mt19937_64 random(8);
  const Retraction pose(Manifold::kSe3, 7);
  for (int repeat = 0; repeat < 5; ++repeat) {
    const std::vector<double> a = RandomValue(pose, &random);
    const std::vector<double> z = RandomValue(pose, &random);
    // With A as the motion from the world, B = Z A: (Z^-1)^-1 A, without an error.
    std::vector<double> z_inverse(7), b(7);
    const std::vector<double> identity = {0, 0, 0, 1, 0, 0, 0};
    pose.Between(z.data(), identity.data(), z_inverse.data());
    pose.Between(z_inverse.data(), a.data(), b.data());
    const std::vector<double> information = RandomInformation(6, &random);
    const RelativePoseFactor exact(Head({0, 1}), z, information);
    for (const double r : Evaluate(exact, {a, b}, nullptr)) EXPECT_NEAR(r, 0, 1e-12);
    const RelativePoseFactor factor(Head({0, 1}), Near(pose, z, &random), information);
    ExpectJacobiansAreDerivatives(factor, {a, b});
  }
}

TEST(BetweenFactor, SquaredNormIsThatOfTheInformation) {
  const Retraction plane(Manifold::kEuclidean, 2);
  const std::vector<double> information = {4, 1, 1, 9};
  const BetweenFactor factor(Head({0, 1}), plane, {1, 1}, information);
  const std::vector<double> r = Evaluate(factor, {{0, 0}, {3, 0}}, nullptr);  // e = (2, -1)
  EXPECT_NEAR(r[0] * r[0] + r[1] * r[1], 4 * 4 - 2 * 2 + 9, 1e-14);
}

TEST(PositionFactor, IsTheCameraCentreWithoutALeverArm) {
  std::mt19937_64 random(3);
  const Retraction pose(Manifold::kSe3, 7);
  const PositionFactor centre(Head({0}), {1, 2, 3}, {0, 0, 0}, {1, 0, 0, 0, 1, 0, 0, 0, 1});
  // A quarter turn about z and t = (4, 5, 6): the centre is -R^T t = (-5, 4, -6).
  const std::vector<double> r =
      Evaluate(centre, {{0, 0, std::sqrt(0.5), std::sqrt(0.5), 4, 5, 6}}, nullptr);
  EXPECT_NEAR(r[0], -5 - 1, 1e-14);
  EXPECT_NEAR(r[1], 4 - 2, 1e-14);
  EXPECT_NEAR(r[2], -6 - 3, 1e-14);
  const PositionFactor antenna(Head({0}), {1, 2, 3}, {0.3, -0.2, 0.5},
                               RandomInformation(3, &random));
  for (int repeat = 0; repeat < 5; ++repeat) {
    ExpectJacobiansAreDerivatives(antenna, {RandomValue(pose, &random)});
  }
}

TEST(VelocityFactor, IsTheMotionOfTheAntennaInTheWorld) {
  // T at the row s is Exp(s m) T: the antenna's position there, by differences.
  const std::vector<double> pose = {0, 0, std::sqrt(0.5), std::sqrt(0.5), 4, 5, 6};
  const std::vector<double> twist = {0.2, -0.1, 0.3, 1, -2, 0.5};
  const double lever[3] = {0.3, -0.2, 0.5}, rho = 0.8, step = 1e-4;
  double place[2][3];
  for (const int side : {0, 1}) {
    double motion[6], inverse[7], moved[3];
    for (int i = 0; i < 6; ++i) motion[i] = (side == 0 ? step : -step) * twist[i];
    const double identity[7] = {0, 0, 0, 1, 0, 0, 0};
    Retraction(Manifold::kSe3, 7).Plus(identity, motion, inverse);  // Exp(-s m)
    double rotation[9];
    QuaternionToRotation(inverse, rotation);
    MatrixVector3(rotation, lever, moved);
    for (int i = 0; i < 3; ++i) moved[i] += inverse[4 + i] - pose[4 + i];
    QuaternionToRotation(pose.data(), rotation);
    VectorMatrix3(moved, rotation, place[side]);
  }
  const std::vector<double> unit = {1, 0, 0, 0, 1, 0, 0, 0, 1}, measured = {0.1, -0.7, 3};
  const VelocityFactor factor(Head({0, 1, 2}), measured, {0.3, -0.2, 0.5}, unit);
  const std::vector<double> r = Evaluate(factor, {pose, twist, {rho}}, nullptr);
  for (int i = 0; i < 3; ++i) {
    const double velocity = (place[1][i] - place[0][i]) / (2 * step) / rho;
    EXPECT_NEAR(r[i], velocity - measured[i], 1e-7);
  }
}

TEST(VelocityFactor, Jacobians) {
  std::mt19937_64 random(6);
  const Retraction pose(Manifold::kSe3, 7), twist(Manifold::kEuclidean, 6);
  for (const std::vector<double>& lever : {std::vector<double>{0, 0, 0}, {0.3, -0.2, 0.5}}) {
    for (int repeat = 0; repeat < 5; ++repeat) {
      const VelocityFactor factor(Head({0, 1, 2}), {3, -2, 0.4}, lever,
                                  RandomInformation(3, &random));
      ExpectJacobiansAreDerivatives(
          factor, {RandomValue(pose, &random), RandomValue(twist, &random), {0.7}});
    }
  }
}

TEST(ReprojectionFactor, JacobiansForDifferentModels) {
  std::mt19937_64 random(4);
  const std::pair<const char*, std::vector<double>> models[] = {
      {"SIMPLE_PINHOLE", {500, 320, 240}},
      {"OPENCV", {500, 510, 320, 240, 0.1, -0.05, 0.01, 0.02}},
      {"OPENCV_FISHEYE", {500, 510, 320, 240, 0.1, -0.05, 0.01, 0.02}}};
  for (const auto& [name, params] : models) {
    const ReprojectionFactor factor(Head({0, 1, 2}), *FindCameraModel(name), {300, 250},
                                    RandomInformation(2, &random));
    const std::vector<double> pose = {0.1, -0.2, 0.05, 0.97, 0.2, -0.1, 4};
    std::vector<double> unit = pose;
    factor.retractions()[0].Normalize(unit.data());
    ExpectJacobiansAreDerivatives(factor, {unit, params, {0.3, -0.4, 0.5}});
  }
}

TEST(ReprojectionFactor, HasNoValueWhereTheModelHasNone) {
  const ReprojectionFactor factor(Head({0, 1, 2}), *FindCameraModel("SIMPLE_PINHOLE"), {300, 250},
                                  {1, 0, 0, 1});
  const std::vector<double> pose = {0, 0, 0, 1, 0, 0, 0}, params = {500, 320, 240},
                            point = {1, 1, 0};
  const double* values[] = {pose.data(), params.data(), point.data()};
  double residual[2];
  EXPECT_FALSE(factor.Evaluate(values, residual, nullptr));
}

TEST(LinearPrior, CostIsTheQuadraticAndAConstant) {
  // Singular: nothing is known of x + y. eta is in the range.
  const Retraction line(Manifold::kEuclidean, 1);
  const LinearPrior factor(Head({0, 1}), {line, line}, {{1}, {2}}, {5, -5, -5, 5}, {10, -10});
  EXPECT_EQ(factor.num_residuals(), 1);
  const auto cost = [&](double x, double y) {
    const double r = Evaluate(factor, {{x}, {y}}, nullptr)[0];
    return 0.5 * r * r;
  };
  const auto quadratic = [](double dx, double dy) {
    return 0.5 * 5 * (dx - dy) * (dx - dy) - 10 * (dx - dy);
  };
  for (const double dx : {-1.0, 0.0, 0.5, 3.0}) {
    EXPECT_NEAR(cost(1 + dx, 2.25) - cost(1, 2), quadratic(dx, 0.25), 1e-13);
  }
  EXPECT_NEAR(cost(1 + 7, 2 + 5), 0, 1e-25);  // dx - dy = 2
}

TEST(LinearPrior, JacobiansOnCurvedManifolds) {
  std::mt19937_64 random(5);
  std::vector<Retraction> retractions(std::begin(kAll), std::end(kAll));
  Values points, values;
  int n = 0;
  for (const Retraction& retraction : retractions) {
    points.push_back(RandomValue(retraction, &random));
    values.push_back(Near(retraction, points.back(), &random));
    n += retraction.tangent_size();
  }
  std::normal_distribution<double> normal;
  std::vector<double> eta(n);
  for (double& value : eta) value = normal(random);
  const LinearPrior factor(Head({0, 1, 2, 3, 4}), retractions, points,
                           RandomInformation(n, &random), eta);
  ExpectJacobiansAreDerivatives(factor, values);
}

TEST(LinearPrior, UnitsDoNotMatter) {
  const Retraction line(Manifold::kEuclidean, 1);
  const LinearPrior factor(Head({0, 1}), {line, line}, {{0}, {0}}, {1e-12, 0, 0, 1e12},
                           {1e-12, 1e12});
  EXPECT_EQ(factor.num_residuals(), 2);
  for (const double r : Evaluate(factor, {{1}, {1}}, nullptr)) EXPECT_NEAR(r, 0, 1e-9);
}

template <typename Make>
void ExpectRefusal(const Make& make, const std::string& words) {
  try {
    make();
    FAIL() << "expected a refusal: " << words;
  } catch (const InputError& error) {
    const std::string found = error.what();
    EXPECT_EQ(found.rfind("factor 0: ", 0), 0U) << found;
    EXPECT_NE(found.find(words), std::string::npos) << found;
    EXPECT_EQ(found.find('\n'), std::string::npos) << found;
  }
}

TEST(Factors, InformationThatIsNoneIsRefused) {
  const Retraction plane(Manifold::kEuclidean, 2);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::pair<std::vector<double>, const char*> cases[] = {
      {{1, 0, 0, 0}, "eigenvalues from 0 to 1"},
      {{1, 2, 2, 1}, "eigenvalues from -1 to 3"},
      {{0, 0, 0, 0}, "eigenvalues"},
      {{1, 1, 1, 1 + 1e-15}, "eigenvalues"},
      {{1, 0.5, 0.4, 1}, "symmetric"},
      {{1, nan, nan, 1}, "finite"},
      {{1, 0, 1}, "2 x 2"}};
  for (const auto& given : cases) {
    const std::vector<double>& information = given.first;
    ExpectRefusal([&] { PriorFactor(Head({0}), plane, {0, 0}, information); }, given.second);
    ExpectRefusal([&] { BetweenFactor(Head({0, 1}), plane, {0, 0}, information); }, given.second);
  }
  const std::vector<double> scaled = {1e-30, 0, 0, 1e30};  // units do not make it singular
  EXPECT_NO_THROW(PriorFactor(Head({0}), plane, {0, 0}, scaled));
}

TEST(Factors, ValuesThatAreNoneAreRefused) {
  const Retraction pose(Manifold::kSe3, 7);
  std::vector<double> information(36, 0.0);
  for (int i = 0; i < 6; ++i) information[7 * i] = 1;
  ExpectRefusal([&] { PriorFactor(Head({0}), pose, {0, 0, 0, 0, 1, 2, 3}, information); },
                "norm 0");
  ExpectRefusal([&] { PriorFactor(Head({0}), pose, {0, 0, 0, 1, 2, 3}, information); },
                "7 numbers");
}

TEST(LinearPrior, WhatIsNoPriorIsRefused) {
  const Retraction line(Manifold::kEuclidean, 1);
  const auto make = [&](std::vector<double> lambda, std::vector<double> eta) {
    LinearPrior(Head({0, 1}), {line, line}, {{0}, {0}}, lambda, eta);
  };
  ExpectRefusal([&] { make({1, 2, 2, 1}, {0, 0}); }, "semidefinite");
  ExpectRefusal([&] { make({0, 0, 0, 0}, {0, 0}); }, "some information");
  ExpectRefusal([&] { make({1, 0, 0.1, 1}, {0, 0}); }, "symmetric");
  ExpectRefusal([&] { make({1, -1, -1, 1}, {1, 1}); }, "eta");
  ExpectRefusal([&] { make({1, 0, 0, 1}, {0}); }, "eta");
}

TEST(VelocityFactor, RefusesWhatIsNone) {
  const std::vector<double> unit = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  const double nan = std::numeric_limits<double>::quiet_NaN();
  ExpectRefusal([&] { VelocityFactor(Head({0, 1, 2}), {1, nan, 0}, {0, 0, 0}, unit); }, "velocity");
  ExpectRefusal([&] { VelocityFactor(Head({0, 1, 2}), {1, 2, 0}, {0, nan, 0}, unit); }, "lever");
  const VelocityFactor factor(Head({0, 1, 2}), {1, 2, 3}, {0, 0, 0}, unit);
  const double pose[] = {0, 0, 0, 1, 0, 0, 0}, twist[] = {0, 0, 0, 1, 1, 1};
  for (const double rho : {0.0, -0.5, nan}) {
    const double* const values[] = {pose, twist, &rho};
    double residual[3];
    EXPECT_FALSE(factor.Evaluate(values, residual, nullptr));
  }
}

TEST(TwistTieFactor, MayTieTheRotationAlone) {
  const double inf = std::numeric_limits<double>::infinity();
  const std::vector<std::vector<double>> values = {
      {0.1, 0.2, 0.3, 4, 5, 6}, {0.8}, {0, 0, 0, 1, 1, 2, 3}, {0.1, 0, 0, 0.995, 0, 2, 1}};
  Values unit = values;
  Retraction(Manifold::kSe3, 7).Normalize(unit[3].data());
  const TwistTieFactor whole(Head({0, 1, 2, 3}), 5, 0.1, 0.2);
  const TwistTieFactor turning(Head({0, 1, 2, 3}), 5, 0.1, inf);
  EXPECT_EQ(whole.num_measurements(), 6);
  EXPECT_EQ(turning.num_measurements(), 3);
  const std::vector<double> r = Evaluate(turning, unit, nullptr);
  const std::vector<double> expected = Evaluate(whole, unit, nullptr);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(r[i], expected[i]);
    EXPECT_EQ(r[3 + i], 0);
  }
  ExpectJacobiansAreDerivatives(whole, unit);
  ExpectJacobiansAreDerivatives(turning, unit);
  ExpectRefusal([&] { TwistTieFactor(Head({0, 1, 2, 3}), 5, inf, 0.2); }, "sigma_w");
  ExpectRefusal([&] { TwistTieFactor(Head({0, 1, 2, 3}), inf, 0.1, 0.2); }, "num_frames");
}

}  // namespace
}  // namespace bundle
