#include "core/geometry/rotation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace bundle {
namespace {

struct LongCoefficients {
  long double a, b, c;
};

/// A, B and C as their power series in s = angle^2, which need no trigonometry:
/// sum (-s)^n / (2n + k)! with k = 1, 2, 3. Good to every digit up to an angle of about 2 pi.
LongCoefficients SeriesCoefficients(long double s) {
  long double sums[3] = {};
  long double term = 1;  // (-s)^n / (2n)!
  for (int n = 0; n < 60; ++n) {
    const long double m = 2.0L * static_cast<long double>(n);
    sums[0] += term / (m + 1);
    sums[1] += term / ((m + 1) * (m + 2));
    sums[2] += term / ((m + 1) * (m + 2) * (m + 3));
    term *= -s / ((m + 1) * (m + 2));
  }
  return {sums[0], sums[1], sums[2]};
}

/// sum W^n / (n + first)! x first!, the matrix exponential (first = 0) or left Jacobian (1) itself.
void MatrixSeries(const double w[3], int first, long double out[9]) {
  const long double x = w[0], y = w[1], z = w[2];
  const long double skew[9] = {0, -z, y, z, 0, -x, -y, x, 0};
  long double power[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  for (int i = 0; i < 9; ++i) out[i] = power[i];
  for (int n = 1; n < 80; ++n) {
    long double next[9];
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        long double sum = 0;
        for (int k = 0; k < 3; ++k) sum += power[3 * r + k] * skew[3 * k + c];
        next[3 * r + c] = sum / static_cast<long double>(n + first);
      }
    }
    for (int i = 0; i < 9; ++i) {
      power[i] = next[i];
      out[i] += power[i];
    }
  }
}

void RandomVector(std::mt19937_64* random, double norm, double out[3]) {
  std::normal_distribution<double> normal;
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    out[i] = normal(*random);
    sum += out[i] * out[i];
  }
  for (int i = 0; i < 3; ++i) out[i] *= norm / std::sqrt(sum);
}

/// From where squares underflow, over both sides of the switch to formulae at 0.5, to a turn.
constexpr double kRotationAngles[] = {0,    1e-300, 1e-160, 1e-20,     1e-8, 1e-4,
                                      0.01, 0.1,    0.25,   0.49999,   0.5,  0.50001,
                                      1.0,  2.0,    3.0,    3.1415926, 3.2,  6.0};

TEST(Rotation, CoefficientsEqualTheirSeries) {
  for (const double angle : kRotationAngles) {
    const RotationCoefficients found = ExpCoefficients(angle * angle);
    const LongCoefficients expected = SeriesCoefficients(static_cast<long double>(angle * angle));
    EXPECT_NEAR(found.a, static_cast<double>(expected.a), 1e-15) << angle;
    EXPECT_NEAR(found.b, static_cast<double>(expected.b), 1e-15) << angle;
    // By its formula C loses the digits of a^3 / 6 in a - sin(a): most at the switch.
    EXPECT_NEAR(found.c, static_cast<double>(expected.c), angle < 0.5 ? 3e-17 : 1e-15) << angle;
  }
}

TEST(Rotation, ExpAndLeftJacobianEqualTheMatrixSeries) {
  std::mt19937_64 random(1);
  for (const double angle : kRotationAngles) {
    for (int repeat = 0; repeat < 20; ++repeat) {
      double w[3], rotation[9], left_jacobian[9];
      RandomVector(&random, angle, w);
      ExpRotation(w, rotation, left_jacobian);
      long double series[9];
      MatrixSeries(w, 0, series);
      for (int i = 0; i < 9; ++i) EXPECT_NEAR(rotation[i], static_cast<double>(series[i]), 3e-15);
      MatrixSeries(w, 1, series);
      for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(left_jacobian[i], static_cast<double>(series[i]), 3e-15);
      }
    }
  }
}

TEST(Rotation, QuaternionIsTheSameRotation) {
  std::mt19937_64 random(2);
  for (const double angle : kRotationAngles) {
    double w[3], rotation[9], left_jacobian[9], q[4], from_quaternion[9];
    RandomVector(&random, angle, w);
    ExpRotation(w, rotation, left_jacobian);
    ExpQuaternion(w, q);
    EXPECT_NEAR(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], 1, 1e-15);
    for (const double scale : {1.0, -3.0, 1e-100, 1e100}) {
      const double scaled[4] = {scale * q[0], scale * q[1], scale * q[2], scale * q[3]};
      QuaternionToRotation(scaled, from_quaternion);
      for (int i = 0; i < 9; ++i) EXPECT_NEAR(from_quaternion[i], rotation[i], 3e-15) << scale;
    }
  }
}

TEST(Rotation, ProductOfQuaternionsIsTheProductOfRotations) {
  std::mt19937_64 random(3);
  for (int repeat = 0; repeat < 50; ++repeat) {
    double w[2][3], q[2][4], rotation[2][9], product[4], expected[9], found[9];
    for (int i = 0; i < 2; ++i) {
      RandomVector(&random, 2.0, w[i]);
      ExpQuaternion(w[i], q[i]);
      QuaternionToRotation(q[i], rotation[i]);
    }
    QuaternionProduct(q[0], q[1], product);
    QuaternionToRotation(product, found);
    MatrixProduct3(rotation[0], rotation[1], expected);
    for (int i = 0; i < 9; ++i) EXPECT_NEAR(found[i], expected[i], 3e-15);
  }
}

TEST(Rotation, WhatIsNotFiniteStaysNotFinite) {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e200}) {
    const double w[3] = {0.1, bad, 0.2};
    double rotation[9], left_jacobian[9];
    ExpRotation(w, rotation, left_jacobian);
    EXPECT_FALSE(std::isfinite(rotation[0])) << bad;
    EXPECT_FALSE(std::isfinite(left_jacobian[0])) << bad;
  }
}

}  // namespace
}  // namespace bundle
