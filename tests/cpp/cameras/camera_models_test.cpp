#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/cameras/registry.h"
#include "support/camera_params.h"

namespace bundle {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();
/// Where finite numbers do arithmetic's worst: underflow, overflow, the thresholds of the models.
constexpr double kExtremes[] = {0,     -0.0,  5e-324, 1e-310, 1e-160, 2.2e-16,  -2.2e-16, 2.3e-16,
                                1e-8,  0.01,  -0.01,  1,      -1,     3.141592, 1e8,      -1e8,
                                1e154, 1e160, -1e160, 1e308,  kNan,   kInf,     -kInf};

/// A buffer with a guard behind it: a write beyond `size` is seen without a sanitizer too.
class Guarded {
 public:
  explicit Guarded(int size) : values_(size + 4, kGuard) {}
  double* data() { return values_.data(); }
  double operator[](int i) const { return values_[i]; }
  bool untouched() const { return CountGuards() == static_cast<int>(values_.size()); }
  bool guard_holds() const {
    return std::all_of(values_.end() - 4, values_.end(), [](double v) { return v == kGuard; });
  }

 private:
  static constexpr double kGuard = -123456.75;
  int CountGuards() const {
    return static_cast<int>(std::count(values_.begin(), values_.end(), kGuard));
  }
  std::vector<double> values_;
};

class CameraModelTest : public ::testing::TestWithParam<int> {
 protected:
  const CameraModel& model() const { return AllCameraModels()[GetParam()]; }
};

/// One projection, with what every call has to keep to.
struct Projected {
  Projection status;
  double xy[2];
  std::vector<double> d_point, d_params;
};

/// The same numbers, or not numbers, whose sign the compiler may choose.
bool Same(const double* a, const double* b, int size) {
  return std::equal(a, a + size, b, [](double x, double y) {
    return std::memcmp(&x, &y, sizeof x) == 0 || (std::isnan(x) && std::isnan(y));
  });
}

Projected Project(const CameraModel& model, const double* params, const double* point) {
  Guarded xy(2), d_point(6), d_params(2 * model.num_params), xy_alone(2);
  const Projection status =
      model.project(params, point, xy.data(), d_point.data(), d_params.data());
  EXPECT_EQ(model.project(params, point, xy_alone.data(), nullptr, nullptr), status);
  EXPECT_TRUE(xy.guard_holds() && d_point.guard_holds() && d_params.guard_holds());
  EXPECT_TRUE(Same(xy.data(), xy_alone.data(), 2)) << "with and without derivatives";
  Guarded only_point(6), only_params(2 * model.num_params);
  model.project(params, point, xy_alone.data(), only_point.data(), nullptr);
  model.project(params, point, xy_alone.data(), nullptr, only_params.data());
  EXPECT_TRUE(Same(only_point.data(), d_point.data(), 6));
  EXPECT_TRUE(Same(only_params.data(), d_params.data(), 2 * model.num_params));
  if (status == Projection::kUndefined) {
    EXPECT_TRUE(xy.untouched() && d_point.untouched() && d_params.untouched());
  }
  return {status,
          {xy[0], xy[1]},
          {d_point.data(), d_point.data() + 6},
          {d_params.data(), d_params.data() + 2 * model.num_params}};
}

/// Romberg's extrapolation of central differences of one pixel coordinate by one argument.
double Differentiate(const CameraModel& model, std::vector<double> arguments, int argument,
                     double step, int row) {
  constexpr int kLevels = 5;
  const double at = arguments[argument];
  double table[kLevels][kLevels];
  for (int level = 0; level < kLevels; ++level, step /= 2) {
    double sides[2][2];
    for (int side = 0; side < 2; ++side) {
      arguments[argument] = at + (side == 0 ? step : -step);
      model.project(&arguments[3], arguments.data(), sides[side], nullptr, nullptr);
    }
    table[level][0] = (sides[0][row] - sides[1][row]) / (2 * step);
    double power = 4;
    for (int k = 1; k <= level; ++k, power *= 4) {
      table[level][k] =
          table[level][k - 1] + (table[level][k - 1] - table[level - 1][k - 1]) / (power - 1);
    }
  }
  return table[kLevels - 1][kLevels - 1];
}

TEST_P(CameraModelTest, JacobiansEqualExtrapolatedDifferences) {
  std::mt19937_64 random(static_cast<uint64_t>(GetParam()) + 1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const std::vector<double> params = testing::UsualParams(model());
  for (int repeat = 0; repeat < 100; ++repeat) {
    const double depth = std::exp(2 * uniform(random));
    const double point[3] = {0.8 * depth * uniform(random), 0.8 * depth * uniform(random), depth};
    std::vector<double> arguments(point, point + 3);
    arguments.insert(arguments.end(), params.begin(), params.end());
    const Projected projected = Project(model(), params.data(), point);
    ASSERT_EQ(projected.status, Projection::kValid);
    for (int row = 0; row < 2; ++row) {
      for (int j = 0; j < 3 + model().num_params; ++j) {
        const double step = j < 3 ? 0.02 * depth : 0.02 * std::max(std::abs(arguments[j]), 0.1);
        const double expected = Differentiate(model(), arguments, j, step, row);
        const double found = j < 3 ? projected.d_point[3 * row + j]
                                   : projected.d_params[row * model().num_params + j - 3];
        // Rounding in 1000 pixels, over the smallest step.
        const double tolerance = 1e-10 * std::abs(expected) + 2e-11 / step + 1e-9;
        EXPECT_NEAR(found, expected, tolerance)
            << "row " << row << " by " << (j < 3 ? "the point" : model().params[j - 3].name);
      }
    }
  }
}

TEST_P(CameraModelTest, ExtremePointsAreHarmless) {
  const std::vector<double> params = testing::UsualParams(model());
  for (const double x : kExtremes) {
    for (const double y : kExtremes) {
      for (const double z : kExtremes) {
        const double point[3] = {x, y, z};
        const Projected projected = Project(model(), params.data(), point);
        if (std::isnan(x) || std::isnan(y) || std::isnan(z)) {
          const bool seen = projected.status != Projection::kUndefined;
          EXPECT_FALSE(seen && std::isfinite(projected.xy[0]) && std::isfinite(projected.xy[1]))
              << "pixels of no point: " << x << " " << y << " " << z;
        }
      }
    }
  }
}

TEST_P(CameraModelTest, ExtremeParametersAreHarmless) {
  const double points[][3] = {{0, 0, 1},     {0.3, -0.2, 1}, {3, 4, 1},      {1e-9, 0, 1},
                              {0.3, 0.2, 0}, {0.3, 0.2, -1}, {1e30, 1, 1e-3}};
  for (int j = 0; j < model().num_params; ++j) {
    std::vector<double> params = testing::UsualParams(model());
    for (const double value : kExtremes) {
      params[j] = value;
      for (const auto& point : points) Project(model(), params.data(), point);
      // All extra parameters alike: polynomials that overflow, denominators that vanish.
      for (int k = j; k < model().num_params; ++k) params[k] = value;
      for (const auto& point : points) Project(model(), params.data(), point);
      params = testing::UsualParams(model());
    }
  }
}

TEST_P(CameraModelTest, BehindIsSaidWhereTheLensCannotSee) {
  const std::vector<double> params = testing::UsualParams(model());
  const std::string name = model().name;
  const bool sees_all = name == "EQUIRECTANGULAR" || name.find("DIVISION") != std::string::npos;
  const bool goes_on = name == "EUCM" || name.find("FISHEYE") != std::string::npos;
  EXPECT_EQ(model().reach, name == "EUCM"        ? CameraReach::kBeyond
                           : sees_all || goes_on ? CameraReach::kAll
                                                 : CameraReach::kFront);
  for (const double x : {0.3, -2.0}) {
    const double behind[3] = {x, 0.4, -1}, front[3] = {x, 0.4, 1};
    EXPECT_EQ(Project(model(), params.data(), front).status, Projection::kValid);
    EXPECT_EQ(Project(model(), params.data(), behind).status, sees_all  ? Projection::kValid
                                                              : goes_on ? Projection::kBeyond
                                                                        : Projection::kBehind);
  }
  const double origin[3] = {};
  EXPECT_EQ(Project(model(), params.data(), origin).status, Projection::kUndefined);
}

TEST_P(CameraModelTest, DifferenceIsThatOfPixelsUpToWholeTurns) {
  const std::vector<double> params = testing::UsualParams(model());
  const double measurement[2] = {1500, 900};
  for (const double x : {1.0, 700.0, 1999.0, 2600.0, -5000.0}) {
    const double xy[2] = {x, 100};
    double residual[2];
    model().difference(params.data(), xy, measurement, residual, nullptr);
    const double turns = (residual[0] - (x - 1500)) / 2000;
    EXPECT_EQ(residual[1], -800);
    EXPECT_EQ(turns, std::round(turns));
    if (std::string(model().name) == "EQUIRECTANGULAR") {
      EXPECT_LE(std::abs(residual[0]), 1000);
    } else {
      EXPECT_EQ(turns, 0);
    }
  }
  for (const double value : kExtremes) {
    const double xy[2] = {value, value};
    double residual[2];
    model().difference(params.data(), xy, measurement, residual, nullptr);
  }
}

INSTANTIATE_TEST_SUITE_P(All, CameraModelTest, ::testing::Range(0, kNumCameraModels),
                         [](const auto& test) { return AllCameraModels()[test.param].name; });

TEST(Registry, FindsEveryModelByItsNameAndNoOther) {
  for (int m = 0; m < kNumCameraModels; ++m) {
    const CameraModel& model = AllCameraModels()[m];
    EXPECT_EQ(FindCameraModel(model.name), &model);
  }
  EXPECT_EQ(FindCameraModel(""), nullptr);
  EXPECT_EQ(FindCameraModel("PINHOLE "), nullptr);
}

}  // namespace
}  // namespace bundle
