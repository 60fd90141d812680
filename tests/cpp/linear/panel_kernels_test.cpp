#include "core/linear/kernels/panel_kernels.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <random>
#include <tuple>
#include <utility>
#include <vector>

namespace bundle::panel_kernels_test {
namespace {

using Matrix = Eigen::MatrixXd;

constexpr double kMark = 1e300;  // what must not be written

Matrix Random(int rows, int columns, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  return Matrix::NullaryExpr(rows, columns, [&] { return normal(random); });
}

/// A panel of S in a taller array: [D; B], D positive definite, its upper triangle undefined.
Matrix MakePanel(int stride, int height, int width, unsigned seed) {
  Matrix panel = Random(stride, width, seed);
  const Matrix d = panel.topRows(width);
  panel.topRows(width) = d * d.transpose() + width * Matrix::Identity(width, width);
  panel.topRows(width).triangularView<Eigen::StrictlyUpper>().setConstant(
      std::numeric_limits<double>::quiet_NaN());
  panel.bottomRows(stride - height).setConstant(kMark);
  return panel;
}

TEST(PanelKernels, FactorizePanelsOfEverySize) {
  for (int width = 1; width <= 19; ++width) {
    for (int below = 0; below <= 51; ++below) {
      const int height = width + below, stride = height + 3;
      const Matrix given = MakePanel(stride, height, width, 100 * width + below);
      Matrix panel = given;
      ASSERT_EQ(SelectPanelKernels().factorize(panel.data(), stride, height, width), 0);
      const Matrix l = panel.topRows(width).triangularView<Eigen::Lower>();
      const Matrix d = given.topRows(width).selfadjointView<Eigen::Lower>();
      ASSERT_LE((l * l.transpose() - d).norm(), 1e-13 * d.norm()) << width << " " << below;
      const Matrix b = given.middleRows(width, below);
      const Matrix x = panel.middleRows(width, below);
      ASSERT_LE((x * l.transpose() - b).norm(), 1e-12 * (b.norm() + 1)) << width << " " << below;
      ASSERT_TRUE((panel.bottomRows(3).array() == kMark).all());
    }
  }
}

TEST(PanelKernels, GiveTheSameBitsInAnyDivisionOfRows) {
  const int width = 21, height = 130;
  const Matrix given = MakePanel(height, height, width, 7);
  Matrix whole = given;
  SelectPanelKernels().factorize(whole.data(), height, height, width);
  for (const int part : {1, 5, 8, 24, 37}) {
    Matrix divided = given;
    SelectPanelKernels().factorize(divided.data(), height, width + part, width);
    for (int row = width + part; row < height; row += part) {
      SelectPanelKernels().solve_rows(divided.data(), height, width, divided.data() + row,
                                      std::min(part, height - row));
    }
    const auto below = [&](const Matrix& m) { return m.bottomRows(height - width).eval(); };
    EXPECT_EQ(below(divided), below(whole)) << part;
  }
}

TEST(PanelKernels, MultiplyAndScatterEverySize) {
  for (const auto& [rows, columns, width] : std::vector<std::tuple<int, int, int>>{{1, 1, 1},
                                                                                   {3, 3, 5},
                                                                                   {7, 2, 3},
                                                                                   {8, 8, 8},
                                                                                   {9, 9, 1},
                                                                                   {24, 11, 6},
                                                                                   {25, 17, 9},
                                                                                   {40, 40, 13},
                                                                                   {203, 48, 6},
                                                                                   {401, 201, 3}}) {
    const int stride = rows + 2;
    const Matrix a = Random(stride, width, rows);
    const Matrix expected = a.topRows(rows) * a.topRows(columns).transpose();
    Matrix c = Matrix::Constant(stride, columns, kMark);
    SelectPanelKernels().product(a.data(), stride, rows, columns, width, c.data(), stride);
    const auto below = [&, n = columns](const Matrix& m) {
      return Matrix(m.topRows(n).triangularView<Eigen::Lower>());
    };
    EXPECT_LE((below(c) - below(expected)).norm(), 1e-13 * expected.norm()) << rows;
    EXPECT_LE((c.middleRows(columns, rows - columns) - expected.bottomRows(rows - columns)).norm(),
              1e-13 * expected.norm());
    EXPECT_TRUE((c.bottomRows(2).array() == kMark).all());
    Matrix d = Matrix::Zero(stride, columns);
    SelectPanelKernels().subtract_product(a.data(), stride, rows, columns, width, d.data(), stride);
    EXPECT_EQ(below(d), below(-c)) << rows;

    // The rows in three ranges with gaps, the first of which ends among the columns.
    const int first = (columns + 1) / 2, second = std::min(rows - first, 9);
    std::vector<RowRange> ranges = {{0, 2, first}};
    if (second > 0) ranges.push_back({first, first + 5, second});
    const int rest = rows - first - second;
    if (rest > 0) ranges.push_back({first + second, first + second + 9, rest});
    std::vector<int> place;
    for (const RowRange& range : ranges) {
      for (int i = 0; i < range.length; ++i) place.push_back(range.target + i);
    }
    const int size = place.back() + 2;
    Matrix to = Random(size, size, 3), reference = to;
    for (int j = 0; j < columns; ++j) {
      for (int i = j; i < rows; ++i) reference(place[i], place[j]) -= c(i, j);
    }
    SelectPanelKernels().scatter(c.data(), stride, columns, ranges.data(),
                                 static_cast<int>(ranges.size()), to.data(), size);
    EXPECT_EQ(to, reference) << rows;
  }
}

TEST(PanelKernels, NameTheMinorThatIsNotPositive) {
  for (const double spoilt : {-1e3, 0.0, std::numeric_limits<double>::quiet_NaN()}) {
    for (const int column : {0, 4, 7, 8, 17}) {
      Matrix panel = MakePanel(25, 25, 18, 5);
      panel(column, column) = spoilt;
      EXPECT_EQ(SelectPanelKernels().factorize(panel.data(), 25, 25, 18), column + 1);
    }
  }
}

TEST(PanelKernels, SolveForwardAndBackward) {
  for (const auto& [width, below] : std::vector<std::pair<int, int>>{{0, 5},
                                                                     {1, 0},
                                                                     {1, 1},
                                                                     {3, 7},
                                                                     {4, 8},
                                                                     {5, 9},
                                                                     {6, 24},
                                                                     {8, 25},
                                                                     {13, 50},
                                                                     {16, 9},
                                                                     {30, 3}}) {
    const int height = width + below;
    Matrix panel = MakePanel(height, height, width, height);
    SelectPanelKernels().factorize(panel.data(), height, height, width);
    const Matrix l = panel.topRows(width).triangularView<Eigen::Lower>();
    const Matrix b = panel.bottomRows(below);
    const Eigen::VectorXd given = Random(width, 1, 1), x = Random(below, 1, 2);
    Eigen::VectorXd y = given, product = Eigen::VectorXd::Constant(below + 1, kMark);
    SelectPanelKernels().forward(panel.data(), height, height, width, y.data(), product.data());
    EXPECT_LE((l * y - given).norm(), 1e-13 * given.norm());
    EXPECT_LE((product.head(below) - b * y).norm(), 1e-13 * (b.norm() + 1));
    EXPECT_EQ(product[below], kMark);
    y = given;
    SelectPanelKernels().backward(panel.data(), height, height, width, y.data(), x.data());
    EXPECT_LE((l.transpose() * y - (given - b.transpose() * x)).norm(), 1e-12 * (given.norm() + 1));
  }
}

}  // namespace
}  // namespace bundle::panel_kernels_test
