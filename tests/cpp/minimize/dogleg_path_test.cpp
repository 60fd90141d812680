// Both doglegs against the plane that they are paths in, searched for the best step.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <random>

#include "core/minimize/dogleg.h"
#include "core/minimize/strategy.h"
#include "support/dense_oracle.h"

namespace bundle {
namespace {

using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

/// A quadratic model in units of D, and its two directions.
struct Model {
  Matrix hessian;
  Vector gradient, newton;
  DoglegProducts products;

  Model(Matrix h, Vector g, double damping) : hessian(std::move(h)), gradient(std::move(g)) {
    const Matrix identity = Matrix::Identity(hessian.rows(), hessian.cols());
    newton = -(oracle::Inverse(hessian + damping * identity) * gradient);
    const Vector hg = hessian * gradient, hn = hessian * newton;
    products = {gradient.dot(gradient), gradient.dot(newton), newton.dot(newton),
                gradient.dot(hg),       gradient.dot(hn),     newton.dot(hn)};
  }

  Vector Step(const Combination& c) const { return c.p * gradient + c.q * newton; }
  double At(const Vector& step) const { return gradient.dot(step) + step.dot(hessian * step) / 2; }
};

Model RandomModel(int seed, double spread) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  Matrix j(7, 5);
  for (double& value : j.reshaped()) value = normal(random);
  for (int k = 0; k < 5; ++k) j.col(k) *= std::pow(spread, k);
  Vector r(7);
  for (double& value : r) value = normal(random);
  return Model(j.transpose() * j, j.transpose() * r, 1e-8);
}

/// The smallest value of the model at distance `radius` among combinations of the directions.
double SearchCircle(const Model& model, double radius) {
  const Vector u = model.gradient.normalized();
  const Vector v = (model.newton - u.dot(model.newton) * u).normalized();
  const auto at = [&](double angle) {
    return model.At(radius * (std::cos(angle) * u + std::sin(angle) * v));
  };
  double best = std::atan2(v.dot(model.newton), u.dot(model.newton));
  for (int k = -100; k < 100; ++k) best = at(k * M_PI / 100) < at(best) ? k * M_PI / 100 : best;
  for (double width = 0.1; width > 1e-12;) {
    const double before = best;
    for (const double angle : {before - width, before + width}) {
      if (at(angle) < at(best)) best = angle;
    }
    if (best == before) width /= 2;
  }
  return at(best);
}

class DoglegPath : public testing::TestWithParam<double> {};

TEST_P(DoglegPath, SubspaceIsTheBestOfItsPlane) {
  for (int seed = 0; seed < 20; ++seed) {
    const Model model = RandomModel(seed, GetParam());
    for (const double share : {1e-8, 1e-4, 0.03, 0.3, 0.9, 0.999999}) {
      const double radius = share * model.newton.norm();
      const Combination c = SubspaceDogleg(model.products, radius);
      const Vector step = model.Step(c);
      EXPECT_EQ(c.length, radius);
      EXPECT_NEAR(step.norm(), radius, 1e-9 * radius);
      const double value = model.At(step), best = SearchCircle(model, radius);
      EXPECT_LT(value, 0);
      EXPECT_NEAR(value, best, 1e-9 * std::abs(best)) << "seed " << seed << ", " << share;
    }
  }
}

TEST_P(DoglegPath, TraditionalGoesByTheCauchyPoint) {
  for (int seed = 0; seed < 20; ++seed) {
    const Model model = RandomModel(seed, GetParam());
    const Vector& g = model.gradient;
    const Vector cauchy = -g.squaredNorm() / g.dot(model.hessian * g) * g;
    const double inside = cauchy.norm(), whole = model.newton.norm();
    ASSERT_LT(inside, whole);
    for (const double share : {1e-8, 0.1, 0.999999}) {
      const Combination c = TraditionalDogleg(model.products, share * inside);
      EXPECT_LT((model.Step(c) - share * cauchy).norm(), 1e-12 * inside);
    }
    for (const double share : {1e-6, 0.1, 0.5, 0.999999}) {
      const double radius = inside + share * (whole - inside);
      const Combination c = TraditionalDogleg(model.products, radius);
      const Vector step = model.Step(c);
      EXPECT_NEAR(step.norm(), radius, 1e-9 * radius);
      EXPECT_GE(c.q, 0);
      EXPECT_LE(c.q, 1);
      EXPECT_LT((step - cauchy - c.q * (model.newton - cauchy)).norm(), 1e-12 * whole);
    }
  }
}

TEST_P(DoglegPath, TakesTheNewtonStepWhole) {
  const Model model = RandomModel(1, GetParam());
  for (const auto path : {TraditionalDogleg, SubspaceDogleg}) {
    const Combination c = path(model.products, 1.001 * model.newton.norm());
    EXPECT_EQ(c.p, 0);
    EXPECT_EQ(c.q, 1);
    EXPECT_DOUBLE_EQ(c.length, model.newton.norm());
  }
}

INSTANTIATE_TEST_SUITE_P(Spreads, DoglegPath, testing::Values(1, 0.3, 0.05));

TEST(DoglegPath, FollowsTheGradientWhereTheNewtonStepIsParallel) {
  const Model model(3 * Matrix::Identity(4, 4), Vector::LinSpaced(4, 1, 2), 1e-8);
  const double radius = model.newton.norm() / 2;
  for (const auto path : {TraditionalDogleg, SubspaceDogleg}) {
    const Combination c = path(model.products, radius);
    const Vector expected = -radius * model.gradient.normalized();
    EXPECT_LT((model.Step(c) - expected).norm(), 1e-12 * radius);
  }
}

// The Newton step is long where the curvature is next to nothing, which must not hide that of the
// gradient.
TEST(DoglegPath, SubspaceStandsCurvatureThatIsNextToNothing) {
  for (const double tiny : {0.0, 1e-16, 1e-10, 1e-5}) {
    Matrix hessian = Matrix::Zero(2, 2);
    hessian.diagonal() << 1, tiny;
    const Model model(hessian, Vector::Ones(2), 1e-8);
    for (const double radius : {0.1, 1.0, 10.0, 1000.0}) {
      const Vector step = model.Step(SubspaceDogleg(model.products, radius));
      EXPECT_NEAR(step.norm(), radius, 1e-6 * radius);
      const double best = SearchCircle(model, radius);
      EXPECT_NEAR(model.At(step), best, 1e-6 * std::abs(best)) << tiny << ", " << radius;
    }
  }
}

/// (H + z)^-1 of the gradient, of length `radius`.
Vector ExactStep(const Model& model, double radius) {
  const auto step = [&](double z) -> Vector {
    return -model.gradient.array() / (model.hessian.diagonal().array() + z);
  };
  double low = 0, high = model.gradient.norm() / radius;
  for (int k = 0; k < 200; ++k) {
    const double middle = (low + high) / 2;
    (step(middle).norm() > radius ? low : high) = middle;
  }
  return step(high);
}

// The angle between the directions goes from what matters to what is lost in rounding.
TEST(DoglegPath, SubspaceIsContinuousAsTheDirectionsBecomeParallel) {
  for (double exponent = -2; exponent > -17; exponent -= 0.125) {
    const double small = std::pow(10, exponent);
    for (const Vector& diagonal : {Vector{{1, 1 + small}}, Vector{{1, small}}, Vector{{1, 0}}}) {
      const Vector gradient = diagonal[1] > 0.5 ? Vector{{1, 1}} : Vector{{1, small}};
      const Model model(diagonal.asDiagonal(), gradient, 1e-8);
      const double radius = model.newton.norm() / 2;
      const Vector step = model.Step(SubspaceDogleg(model.products, radius));
      EXPECT_LT((step - ExactStep(model, radius)).norm(), 1e-7 * radius) << exponent;
    }
  }
}

}  // namespace
}  // namespace bundle
