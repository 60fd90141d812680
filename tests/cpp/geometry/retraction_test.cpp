#include "core/geometry/retraction.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "core/error.h"

namespace bundle {
namespace {

using Matrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

const Retraction kAll[] = {{Manifold::kEuclidean, 4},
                           {Manifold::kSo2, 1},
                           {Manifold::kSo3, 4},
                           {Manifold::kSe2, 3},
                           {Manifold::kSe3, 7}};

/// The Lie algebra's matrix of tangent coordinates, homogeneous: what the definition says, with
/// nothing of the closed forms.
Matrix Hat(const Retraction& retraction, const std::vector<double>& d) {
  const auto planar = [](long double x, long double y, long double a) {
    Matrix m = Matrix::Zero(3, 3);
    m << 0, -a, x, a, 0, y, 0, 0, 0;
    return m;
  };
  switch (retraction.manifold()) {
    case Manifold::kEuclidean: {
      const auto n = static_cast<Eigen::Index>(d.size());
      Matrix m = Matrix::Zero(n + 1, n + 1);
      for (Eigen::Index i = 0; i < n; ++i) m(i, n) = d[i];
      return m;
    }
    case Manifold::kSo2:
      return planar(0, 0, d[0]);
    case Manifold::kSe2:
      return planar(d[0], d[1], d[2]);
    default: {
      Matrix m = Matrix::Zero(4, 4);
      m.topLeftCorner(3, 3) << 0, -d[2], d[1], d[2], 0, -d[0], -d[1], d[0], 0;
      for (size_t i = 3; i < d.size(); ++i) m(i - 3, 3) = d[i];
      return m;
    }
  }
}

/// sum A^n / (n + first)! first!
Matrix Series(const Matrix& a, int first) {
  Matrix term = Matrix::Identity(a.rows(), a.cols()), sum = term;
  for (int n = 1; n < 120; ++n) {
    term = (term * a / static_cast<long double>(n + first)).eval();
    sum += term;
  }
  return sum;
}

/// The matrix that a stored value stands for.
Matrix ToMatrix(const Retraction& retraction, const std::vector<double>& x) {
  if (retraction.manifold() == Manifold::kEuclidean) return Series(Hat(retraction, x), 0);
  if (retraction.ambient_size() <= 3) {
    const bool moves = retraction.manifold() == Manifold::kSe2;
    const long double a = x.back();
    Matrix m = Matrix::Identity(3, 3);
    m(0, 0) = m(1, 1) = std::cos(a);
    m(1, 0) = std::sin(a);
    m(0, 1) = -m(1, 0);
    if (moves) m(0, 2) = x[0], m(1, 2) = x[1];
    return m;
  }
  Matrix m = Matrix::Identity(4, 4);
  m.topLeftCorner(3, 3) =
      Eigen::Quaternion<long double>(x[3], x[0], x[1], x[2]).normalized().toRotationMatrix();
  for (size_t i = 4; i < x.size(); ++i) m(i - 4, 3) = x[i];
  return m;
}

std::vector<double> RandomTangent(const Retraction& retraction, double angle,
                                  std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<double> d(retraction.tangent_size());
  for (double& value : d) value = 2 * normal(*random);
  // Which coordinates are rotations, scaled to the angle.
  size_t begin = 0, end = 0;
  if (retraction.manifold() == Manifold::kSe2) begin = 2, end = 3;
  if (retraction.manifold() == Manifold::kSo2) end = 1;
  if (retraction.ambient_size() >= 4 && retraction.manifold() != Manifold::kEuclidean) end = 3;
  double norm = 0;
  for (size_t i = begin; i < end; ++i) norm += d[i] * d[i];
  for (size_t i = begin; i < end; ++i) d[i] *= angle / std::sqrt(norm);
  return d;
}

std::vector<double> RandomValue(const Retraction& retraction, std::mt19937_64* random) {
  std::vector<double> x(retraction.ambient_size(), 0.0);
  if (retraction.ambient_size() >= 4 && retraction.manifold() != Manifold::kEuclidean) x[3] = 1;
  const std::vector<double> d = RandomTangent(retraction, 1.9, random);
  retraction.Plus(x.data(), d.data(), x.data());
  return x;
}

Matrix ToMatrix(const std::vector<double>& values, int rows) {
  return Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
             values.data(), rows, rows)
      .cast<long double>();
}

double Difference(const Matrix& a, const Matrix& b) {
  return static_cast<double>((a - b).cwiseAbs().maxCoeff());
}

/// ad_d e = [d, e] in coordinates: the columns are brackets of matrices.
Matrix AdjointOfAlgebra(const Retraction& retraction, const std::vector<double>& d) {
  const int n = retraction.tangent_size();
  Matrix ad = Matrix::Zero(n, n);
  const Matrix hat = Hat(retraction, d);
  std::vector<Matrix> basis;
  for (int j = 0; j < n; ++j) {
    std::vector<double> unit(n, 0.0);
    unit[j] = 1;
    basis.push_back(Hat(retraction, unit));
  }
  for (int j = 0; j < n; ++j) {
    const Matrix bracket = hat * basis[j] - basis[j] * hat;
    for (int i = 0; i < n; ++i) {  // basis matrices are orthogonal to each other
      ad(i, j) = bracket.cwiseProduct(basis[i]).sum() / basis[i].squaredNorm();
    }
  }
  return ad;
}

// Beside pi and its neighbours: the ends of every series, and where cot and atan2 are delicate.
constexpr double kAngles[] = {0,    1e-300, 1e-12, 1e-9, 1e-5, 0.00999, 0.01001, 0.2,
                              0.49, 0.51,   0.99,  1.01, 2,    3,       3.1415,  M_PI - 1e-9};

TEST(Retraction, PlusIsTheMatrixExponentialAndLocalUndoesIt) {
  std::mt19937_64 random(1);
  for (const Retraction& retraction : kAll) {
    for (const double angle : kAngles) {
      const std::vector<double> x = RandomValue(retraction, &random);
      const std::vector<double> d = RandomTangent(retraction, angle, &random);
      std::vector<double> y(x.size()), found(d.size());
      retraction.Plus(x.data(), d.data(), y.data());
      const Matrix expected = ToMatrix(retraction, x) * Series(Hat(retraction, d), 0);
      EXPECT_LT(Difference(ToMatrix(retraction, y), expected), 2e-14)
          << retraction.name() << " " << angle;
      retraction.Local(x.data(), y.data(), found.data());
      for (size_t i = 0; i < d.size(); ++i) {
        EXPECT_NEAR(found[i], d[i], 4e-14) << retraction.name() << " " << angle;
      }
    }
  }
}

TEST(Retraction, RightJacobianIsTheSeriesOfTheAdjointAlgebraAndHasItsInverse) {
  std::mt19937_64 random(2);
  for (const Retraction& retraction : kAll) {
    const int n = retraction.tangent_size();
    for (const double angle : kAngles) {
      const std::vector<double> d = RandomTangent(retraction, angle, &random);
      std::vector<double> jacobian(n * n), inverse(n * n);
      retraction.RightJacobian(d.data(), jacobian.data());
      retraction.InverseRightJacobian(d.data(), inverse.data());
      const Matrix expected = Series(-AdjointOfAlgebra(retraction, d), 1);
      EXPECT_LT(Difference(ToMatrix(jacobian, n), expected), 4e-14)
          << retraction.name() << " " << angle;
      EXPECT_LT(Difference(expected * ToMatrix(inverse, n), Matrix::Identity(n, n)), 2e-13)
          << retraction.name() << " " << angle;
    }
  }
}

TEST(Retraction, AdjointAndBetweenAreThoseOfMatrices) {
  std::mt19937_64 random(3);
  for (const Retraction& retraction : kAll) {
    const int n = retraction.tangent_size();
    const std::vector<double> x = RandomValue(retraction, &random);
    const std::vector<double> y = RandomValue(retraction, &random);
    const Matrix inverse = ToMatrix(retraction, x).inverse();
    std::vector<double> adjoint(n * n), between(x.size());
    retraction.Adjoint(x.data(), adjoint.data());
    for (int j = 0; j < n; ++j) {
      std::vector<double> unit(n, 0.0), column(n);
      unit[j] = 1;
      for (int i = 0; i < n; ++i) column[i] = adjoint[i * n + j];
      const Matrix expected = ToMatrix(retraction, x) * Hat(retraction, unit) * inverse;
      EXPECT_LT(Difference(Hat(retraction, column), expected), 1e-14) << retraction.name();
    }
    retraction.Between(x.data(), y.data(), between.data());
    const Matrix expected = inverse * ToMatrix(retraction, y);
    EXPECT_LT(Difference(ToMatrix(retraction, between), expected), 1e-14) << retraction.name();
  }
}

TEST(Retraction, AnglesAcrossHalfATurnAreClose) {
  for (const Manifold manifold : {Manifold::kSo2, Manifold::kSe2}) {
    const int size = manifold == Manifold::kSo2 ? 1 : 3;
    const Retraction retraction(manifold, size);
    for (const double turns : {0.0, 1.0, -3.0}) {
      std::vector<double> x(size, 0.0), y(size, 0.0), d(size);
      x.back() = M_PI - 0.01;
      y.back() = -M_PI + 0.02 + 2 * M_PI * turns;
      retraction.Local(x.data(), y.data(), d.data());
      EXPECT_NEAR(d.back(), 0.03, 1e-14);
    }
  }
}

TEST(Retraction, BothQuaternionsOfARotationAreTheSame) {
  const Retraction retraction(Manifold::kSo3, 4);
  const double one[4] = {0, 0, 0, 1}, q[4] = {0.1, -0.2, 0.3, 0.8};
  const double minus[4] = {-0.1, 0.2, -0.3, -0.8};
  double d[3], other[3];
  retraction.Local(one, q, d);
  retraction.Local(one, minus, other);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(d[i], other[i]);
  EXPECT_GT(d[0], 0);
}

TEST(Retraction, QuaternionsAreScaledUnlessTheyHaveNoNorm) {
  const Retraction retraction(Manifold::kSe3, 7);
  for (const double scale : {1e-200, 3.0, -1e200}) {
    double x[7] = {scale, 0, scale, 0, 5, 6, 7};
    EXPECT_TRUE(retraction.Normalize(x));
    EXPECT_NEAR(std::abs(x[0]), std::sqrt(0.5), 1e-15);
    EXPECT_EQ(x[4], 5);
  }
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double bad : {0.0, nan, std::numeric_limits<double>::infinity()}) {
    double x[7] = {0, bad, 0, 0, 5, 6, 7};
    EXPECT_FALSE(retraction.Normalize(x)) << bad;
  }
}

TEST(Retraction, SizesAndNamesThatDoNotFitAreRefused) {
  EXPECT_EQ(RetractionFromName("se3", 7).tangent_size(), 6);
  EXPECT_EQ(RetractionFromName("euclidean", 9).tangent_size(), 9);
  EXPECT_THROW(RetractionFromName("se3", 6), InputError);
  EXPECT_THROW(RetractionFromName("euclidean", 0), InputError);
  EXPECT_THROW(RetractionFromName("sim3", 8), InputError);
}

}  // namespace
}  // namespace bundle
