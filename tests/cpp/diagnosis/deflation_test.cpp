#include "core/diagnosis/deflation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/dense/krylov.h"

namespace bundle {
namespace {

Eigen::MatrixXd Ramp(int rows, int columns) {
  Eigen::MatrixXd matrix(rows, columns);
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < columns; ++j) matrix(i, j) = std::sin(1.7 * i + 0.9 * j * j + 0.3 * i * j);
  }
  return matrix;
}

TEST(Deflation, KeepsTheDirectionsOfEachPieceApart) {
  const std::vector<int> piece = {0, 1, 0, 1, -1, 0, 1, 0};
  Deflation known(piece, Ramp(8, 2));
  EXPECT_EQ(known.count(), 4);
  known.Add(Eigen::VectorXd::Unit(8, 4));
  const Eigen::MatrixXd all = known.Dense();
  ASSERT_EQ(all.cols(), 5);
  EXPECT_LT((all.transpose() * all - Eigen::MatrixXd::Identity(5, 5)).norm(), 1e-13);
  for (int i = 0; i < 8; ++i) {
    for (int k = 0; k < 4; ++k) {
      if (piece[i] == k / 2) continue;
      EXPECT_EQ(all(i, k), 0);
    }
  }
  const Eigen::MatrixXd x = Ramp(8, 3);
  EXPECT_LT((known.Project(x) - (x - all * (all.transpose() * x))).norm(), 1e-13);
}

TEST(Deflation, KeepsCombinationsWithoutEnergy) {
  // Of the plane of the first two unknowns, only (1, 1) is null.
  Eigen::MatrixXd a = Eigen::MatrixXd::Identity(4, 4);
  a.topLeftCorner(2, 2) << 1, -1, -1, 1;
  Deflation known({0, 0, 1, 1}, Eigen::MatrixXd::Identity(4, 4).leftCols(3));
  EXPECT_EQ(known.count(), 3);  // the second piece has one
  known.KeepNull(a * known.directions(), 1e-11);
  ASSERT_EQ(known.count(), 1);
  const Eigen::MatrixXd kept = known.Dense();
  EXPECT_NEAR(std::abs(kept(0, 0)), std::sqrt(0.5), 1e-14);
  EXPECT_NEAR(kept(0, 0), kept(1, 0), 1e-14);
  EXPECT_EQ(kept.bottomRows(2).norm(), 0);
}

}  // namespace
}  // namespace bundle
