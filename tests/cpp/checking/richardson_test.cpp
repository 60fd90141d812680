#include <bundle/richardson.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace bundle {
namespace {

struct Found {
  double derivative = 0, uncertainty = 0;
  int num_calls = 0;
};

template <typename Function>
Found Differentiate(const Function& f, double first_step, double noise) {
  Found found;
  const LineFunction line = [&](double step, double* value) {
    ++found.num_calls;
    *value = f(step);
    return std::isfinite(*value);
  };
  noise = std::max(noise, FindResolution(line, 1, first_step, &noise).jump[0]);
  RichardsonDerivative(line, 1, first_step, &noise, &found.derivative, &found.uncertainty,
                       8 * first_step);
  return found;
}

/// D(h) = 1 + h^2 + h^4 + h^6 is 1 to the last bits once three powers are removed, at steps of 1,
/// 1/2, 1/4 and 1/8; one more row shows it. Smaller steps are taken to confirm it only.
TEST(Richardson, RemovesOnePowerOfTheStepAfterTheOther) {
  const auto polynomial = [](double x) { return x * (1 + x * x * (1 + x * x * (1 + x * x))); };
  const Found found = Differentiate(polynomial, 1, 1e-16);
  EXPECT_NEAR(found.derivative, 1, 1e-13);
  EXPECT_LT(found.uncertainty, 1e-12);
  EXPECT_LE(found.num_calls, 21);
}

/// Smooth functions of any scale, from steps that are far too large: the bound is small, and holds
/// but for one in thousands, which agrees with its parents by chance.
TEST(Richardson, TheBoundHolds) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int num_tight = 0, num_exceeded = 0;
  constexpr int kTrials = 20000;
  for (int trial = 0; trial < kTrials; ++trial) {
    const double frequency = std::pow(10, 1.5 * uniform(random)), phase = 3 * uniform(random);
    const double slope = uniform(random), pole = std::pow(10, 1 + uniform(random));
    const auto f = [&](double x) {
      return std::sin(frequency * x + phase) + slope * x + 1 / (x + pole) + std::exp(slope * x);
    };
    const double exact = frequency * std::cos(phase) + 2 * slope - 1 / (pole * pole);
    const double noise = 2.2e-16 * (4 + frequency + 1 / pole);
    const Found found = Differentiate(f, 1, noise);
    const double error = std::abs(found.derivative - exact) - 1e-14 * std::abs(exact);
    if (error > found.uncertainty) ++num_exceeded;
    EXPECT_LE(error, 4 * found.uncertainty) << trial;
    if (found.uncertainty < 1e-8 * (1 + frequency)) ++num_tight;
  }
  EXPECT_GT(num_tight, 0.9 * kTrials);
  EXPECT_LE(num_exceeded, 3);
}

/// s(h) = h - a h^3 is the same at two scales here, at 1 and 1/64, and falls from there on.
TEST(Richardson, SlopesThatDifferAlikeAtTwoScalesAreNoKink) {
  const double a = 1 - 1.0 / 64;
  const auto f = [a](double x) { return x + x * x * (1 - a * x * x); };
  const Found found = Differentiate(f, 1, 1e-16);
  EXPECT_NEAR(found.derivative, 1, 1e-12);
  EXPECT_LT(found.uncertainty, 1e-10);
}

/// Even where the curvature hides some of the kink at every step that is taken.
TEST(Richardson, AtAKinkTheBoundReachesTheSlopesOfBothSides) {
  for (const double curvature : {0.0, -0.5, -5.0}) {
    const auto f = [curvature](double x) { return 2 * x + std::abs(x) + curvature * x * x; };
    const Found found = Differentiate(f, 1, 1e-16);
    EXPECT_GE(found.derivative + found.uncertainty, 3) << curvature;
    EXPECT_LE(found.derivative - found.uncertainty, 1) << curvature;
    EXPECT_LT(found.uncertainty, 1.2) << curvature;
  }
}

/// D(h) = 1 - 5 h^2 + 4 h^4 is zero at steps of 1 and 1/2, as if it had settled there. The smaller
/// steps that confirm a result cannot tell, for all the rounding.
TEST(Richardson, WhatAgreesByChanceIsHeldAgainstTheNextStep) {
  const auto f = [](double x) { return x * (1 - x * x * (5 - 4 * x * x)); };
  const Found found = Differentiate(f, 1, 4e-3);
  EXPECT_NEAR(found.derivative, 1, found.uncertainty);
  EXPECT_LT(found.uncertainty, 0.1);
}

/// Large steps settle on the slope 3, the smallest on 3 + 1e-7 with a wider bound.
TEST(Richardson, SmallerStepsOverruleLargerOnesThatWentAcrossSomething) {
  const auto f = [](double x) { return 3 * x + 1e-12 * std::tanh(x / 1e-5); };
  const Found found = Differentiate(f, 1.0 / 8, 1e-16);
  EXPECT_NEAR(found.derivative, 3 + 1e-7, found.uncertainty);
  EXPECT_LT(found.uncertainty, 2e-8);
}

/// Here f has no value between 0.2 and 0.6, and is another function beyond.
TEST(Richardson, WhatLiesBeyondAGapTellsNothing) {
  const auto f = [](double x) {
    if (std::abs(x) > 0.6) return 1e8 * x;
    return std::abs(x) > 0.2 ? NAN : 3 * x + 1e-12 * std::tanh(x / 1e-5);
  };
  const Found found = Differentiate(f, 1, 1e-20);
  EXPECT_NEAR(found.derivative, 3 + 1e-7, found.uncertainty);
  EXPECT_LT(found.uncertainty, 2e-8);
}

/// Differences at the steps that confirm a result are mostly rounding.
TEST(Richardson, RoundingAtSmallStepsIsNoDoubt) {
  const auto f = [](double x) {
    const volatile double sum = 1e6 + std::sin(x + 1);
    return sum - 1e6;
  };
  const Found found = Differentiate(f, 1, 1.2e-10);
  EXPECT_NEAR(found.derivative, std::cos(1), found.uncertainty);
  EXPECT_LT(found.uncertainty, 1e-8);
}

/// The value stands still at all steps but the largest, where it jumps.
TEST(Richardson, JumpsAtTheLargestStepAreNoise) {
  const auto f = [](double x) { return std::floor(3 * x + 0.3); };
  const Found found = Differentiate(f, 0.5, 1e-16);
  EXPECT_GE(found.uncertainty, 1);
}

/// As a robust loss that ends at a border within the largest step.
TEST(Richardson, AFeatureAtTheLargestStepIsNoNoise) {
  const auto f = [](double x) { return x > 0.3 ? std::pow(x - 0.3, 2) : 0.0; };
  const Found found = Differentiate(f, 0.5, 1e-16);
  EXPECT_EQ(found.derivative, 0);
  EXPECT_LT(found.uncertainty, 1e-12);
}

/// Two powers remove the pole at -1/16 from the smallest steps. The longest cross it, so that their
/// slopes are huge: small beside those is no measure.
TEST(Richardson, SlopesBesideAPoleAreNoMeasure) {
  const auto f = [](double x) { return x + 1e-9 * std::pow(1 / (1 + 15.99 * x), 8); };
  const Found found = Differentiate(f, 1.0 / 16, 1e-16);
  EXPECT_NEAR(found.derivative, 1 - 8e-9 * 15.99, found.uncertainty);
  EXPECT_LT(found.uncertainty, 1e-9);
}

/// A sum with a large constant: eight times the first step has an eighth of its rounding errors.
TEST(Richardson, LongerStepsDivideRoundingErrors) {
  const auto f = [](double x) {
    const volatile double sum = 1e7 + std::sin(x + 1);
    return sum - 1e7;
  };
  const Found found = Differentiate(f, 1.0 / 128, 2e-9);
  EXPECT_NEAR(found.derivative, std::cos(1), found.uncertainty);
  EXPECT_LT(found.uncertainty, 5e-7);  // 3e-6 by the first step
}

/// The longer step crosses a kink at 0.02, and settles on no value that agrees.
TEST(Richardson, LongerStepsAreToAgreeWithShorterOnes) {
  const auto f = [](double x) {
    const volatile double sum = 1e7 + x + (x > 0.02 ? 3 * (x - 0.02) : 0.0);
    return sum - 1e7;
  };
  const Found found = Differentiate(f, 1.0 / 128, 2e-9);
  EXPECT_NEAR(found.derivative, 1, found.uncertainty);
  EXPECT_GT(found.uncertainty, 1e-7);
  EXPECT_LT(found.uncertainty, 2e-6);
}

/// A clamp stands still below its border, at any step, which is no jump.
TEST(Richardson, TheBorderOfAClampIsNoNoise) {
  for (const double border : {1e-2, 1e-3, 1e-4, 1e-5, 1e-6}) {
    const auto f = [border](double x) { return std::clamp(-1 - border + x, -1.0, 1.0); };
    const Found found = Differentiate(f, (1 + border) / 16, 1e-15);
    EXPECT_NEAR(found.derivative, 0, found.uncertainty) << border;
  }
}

/// Beyond 0.01 the slope is 2, exactly and at several steps.
TEST(Richardson, LongerStepsDoNotOverruleShorterOnes) {
  const auto f = [](double x) { return std::abs(x) > 0.01 ? 2 * x : x; };
  const Found found = Differentiate(f, 1.0 / 128, 2e-9);
  EXPECT_NEAR(found.derivative, 1, found.uncertainty);
}

/// A jump at the point itself, which only the steps that confirm a result see.
TEST(Richardson, LongerStepsRemoveNoDisagreement) {
  const auto f = [](double x) { return x + 1e-7 * std::tanh(x / 1e-12); };
  const Found found = Differentiate(f, 1.0 / 128, 2e-9);
  EXPECT_GT(found.uncertainty, 100);
}

/// The first value is rounded and needs the longer step; the second is a staircase.
TEST(Richardson, LongerStepsAreForRoundedValuesOnly) {
  const double noise[] = {1e-7, 1};
  double derivative[2], uncertainty[2];
  const LineFunction line = [](double step, double* values) {
    values[0] = std::sin(step);
    values[1] = std::floor(3 * step + 0.3);
    return true;
  };
  RichardsonDerivative(line, 2, 0.5, noise, derivative, uncertainty, 4);
  EXPECT_LT(uncertainty[0], 1e-6);
  EXPECT_GE(uncertainty[1], 1);
}

TEST(Richardson, NoStepIsLongerThanTheLongest) {
  const double noise = 2e-9, first = 1.0 / 128;
  for (const double longest : {0.0, first, 8 * first}) {
    double reached = 0, derivative = 0, uncertainty = 0;
    const LineFunction line = [&](double step, double* value) {
      reached = std::max(reached, std::abs(step));
      *value = step;
      return true;
    };
    RichardsonDerivative(line, 1, first, &noise, &derivative, &uncertainty, longest);
    EXPECT_EQ(reached, std::max(first, longest));
  }
}

}  // namespace
}  // namespace bundle
