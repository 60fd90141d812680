#include "core/sums/double_double.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace bundle {
namespace {

std::vector<double> RandomValues(int count) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::vector<double> values;
  for (int i = 0; i < count; ++i) values.push_back(std::ldexp(normal(random), i % 40 - 20));
  return values;
}

TEST(DoubleDouble, IsTheSameInAnyOrder) {
  std::vector<double> values = RandomValues(1000);
  std::mt19937 random(2);
  DoubleDouble first;
  double plain = 0;
  for (const double value : values) first.Add(value), plain += value;
  bool plain_differs = false;
  for (int k = 0; k < 50; ++k) {
    std::shuffle(values.begin(), values.end(), random);
    DoubleDouble parts[3];
    double other = 0;
    for (size_t i = 0; i < values.size(); ++i) parts[i % 3].Add(values[i]), other += values[i];
    DoubleDouble sum;
    for (const DoubleDouble& part : parts) sum.Add(part);
    EXPECT_EQ(sum.Rounded(), first.Rounded());
    plain_differs |= other != plain;
  }
  EXPECT_TRUE(plain_differs);
}

TEST(DoubleDouble, KeepsWhatCancels) {
  DoubleDouble sum;
  for (const double value : {1e16, 1.0, -1e16, 1e-3}) sum.Add(value);
  EXPECT_EQ(sum.Rounded(), 1.001);
}

TEST(DoubleDouble, OfWhatIsNotFiniteIsNot) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  DoubleDouble sum;
  sum.Add(1);
  sum.Add(kInfinity);
  EXPECT_EQ(sum.Rounded(), kInfinity);
  sum.Add(1);
  EXPECT_EQ(sum.Rounded(), kInfinity);
  sum.Add(-kInfinity);
  EXPECT_TRUE(std::isnan(sum.Rounded()));
}

}  // namespace
}  // namespace bundle
