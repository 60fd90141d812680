/// Against the rotation of a singular value decomposition.

#include "core/pose_graph/nearest_rotation.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "core/geometry/rotation.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

TEST(NearestRotation, HasTheLargestTraceForAnySignOfTheDeterminant) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  int reflections = 0;
  for (int k = 0; k < 400; ++k) {
    Matrix3 m;
    for (double& value : m.reshaped()) value = normal(random);
    if (k % 4 == 0) m *= 1e-6;
    if (k % 5 == 0) m.row(2) = m.row(0) + 1e-9 * m.row(2);  // nearly singular
    reflections += m.determinant() < 0 ? 1 : 0;
    double pose[7] = {0, 0, 0, 1, 1, 2, 3};
    SetNearestRotation(3, m.data(), pose);
    EXPECT_NEAR(QuaternionNorm(pose), 1, 1e-14);
    EXPECT_EQ(pose[6], 3);
    Matrix3 rotation;
    QuaternionToRotation(pose, rotation.data());
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(Eigen::Matrix3d(m),
                                                Eigen::ComputeFullU | Eigen::ComputeFullV);
    const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
    const Eigen::Vector3d s = svd.singularValues();
    EXPECT_NEAR((rotation.transpose() * m).trace(), s[0] + s[1] + sign * s[2], 1e-13 * s[0]) << k;
  }
  EXPECT_GT(reflections, 100);
}

TEST(NearestRotation, IsExactForARotation) {
  const double w[3] = {0.3, -2.1, 1.2};
  double rotation[9], jacobian[9], found[9], pose[7] = {};
  ExpRotation(w, rotation, jacobian);
  SetNearestRotation(3, rotation, pose);
  QuaternionToRotation(pose, found);
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(found[i], rotation[i], 1e-15);
}

TEST(NearestRotation, StaysWhereNoneIsNearer) {
  const double zero[9] = {};
  double pose[7] = {0.5, 0.5, 0.5, 0.5, 1, 2, 3}, planar[3] = {1, 2, 0.7};
  SetNearestRotation(3, zero, pose);
  SetNearestRotation(2, zero, planar);
  EXPECT_EQ(pose[0], 0.5);
  EXPECT_EQ(planar[2], 0.7);
  const double turn[4] = {0, -2, 2, 0};
  SetNearestRotation(2, turn, planar);
  EXPECT_NEAR(planar[2], M_PI / 2, 1e-15);
}

}  // namespace
}  // namespace bundle
