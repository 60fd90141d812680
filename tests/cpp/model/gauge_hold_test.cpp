#include "core/model/gauge_hold.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/model/gauge.h"
#include "core/model/gauge_count.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::Scene;

Scene FourImages() {
  testing::SceneOptions options;
  options.num_images = 4;
  options.num_points = 12;
  return testing::MakeScene(options);
}

/// The bits that are held of each image's pose, with what is held beforehand.
std::vector<uint8_t> Held(const AdjustmentProblem& problem, const SolveOptions& options = {}) {
  const FreeParameters before = SelectFreeParameters(problem, options);
  FreeParameters free = before;
  const int degrees = CountGaugeDegrees(problem, free);
  EXPECT_EQ(FixGauge(problem, Gauge::kTwoCameras, &free), "");
  EXPECT_EQ(CountGaugeDegrees(problem, free), 0);
  EXPECT_EQ(free.point, before.point);
  std::vector<uint8_t> held(problem.num_images);
  int count = 0;
  for (int i = 0; i < problem.num_images; ++i) {
    held[i] = before.pose[i] & static_cast<uint8_t>(~free.pose[i]);
    count += __builtin_popcount(held[i]);
  }
  EXPECT_EQ(count, degrees);
  return held;
}

SolveOptions HoldPoints(const Scene& scene, int count) {
  SolveOptions options;
  options.fixed_point_ids.assign(scene.point_ids.begin(), scene.point_ids.begin() + count);
  return options;
}

constexpr int kTurn = 0b000111;

TEST(GaugeHold, WithNothingHeldTheFirstPoseAndACoordinateOfTheSecond) {
  const std::vector<uint8_t> held = Held(FourImages().View());
  EXPECT_EQ(held[0], FreeParameters::kWholePose);
  EXPECT_EQ(__builtin_popcount(held[1]), 1);
  EXPECT_EQ(held[1] & kTurn, 0);
  EXPECT_EQ(held[2] | held[3], 0);
}

/// A turn about the point and the scale; a turn about the line of two.
TEST(GaugeHold, PointsThatAreHeldLeaveTurnsAndTheScale) {
  const Scene scene = FourImages();
  const std::vector<uint8_t> one = Held(scene.View(), HoldPoints(scene, 1));
  EXPECT_EQ(one[0] & kTurn, kTurn);
  EXPECT_EQ(__builtin_popcount(one[0]), 4);
  const std::vector<uint8_t> two = Held(scene.View(), HoldPoints(scene, 2));
  EXPECT_EQ(__builtin_popcount(two[0] & kTurn), 1);
  for (const int count : {3, 4, 12}) {
    EXPECT_EQ(Held(scene.View(), HoldPoints(scene, count)), std::vector<uint8_t>(4));
  }
}

TEST(GaugeHold, PointsOnALineOrAtOnePlaceLeaveWhatTheyLeave) {
  Scene scene = FourImages();
  for (int j = 0; j < 3; ++j) {
    scene.points[3 + j] = scene.points[j] + (j + 1) * 0.1;
    scene.points[6 + j] = scene.points[j] - (j + 1) * 0.05;
  }
  EXPECT_EQ(__builtin_popcount(Held(scene.View(), HoldPoints(scene, 3))[0]), 1);
  for (int j = 0; j < 6; ++j) scene.points[3 + j] = scene.points[j % 3];
  EXPECT_EQ(__builtin_popcount(Held(scene.View(), HoldPoints(scene, 3))[0]), 4);
}

/// Turns about a point 1e7 scenes away are shifts across its direction.
TEST(GaugeHold, APointFarAwayLeavesShifts) {
  Scene scene = FourImages();
  scene.points[2] = 1e7;
  const std::vector<uint8_t> held = Held(scene.View(), HoldPoints(scene, 1));
  EXPECT_EQ(__builtin_popcount(held[0] & kTurn), 1);
  EXPECT_EQ(__builtin_popcount(held[0]), 4);
}

/// Images that stand nearly where the first does would make the scale a guess.
TEST(GaugeHold, AShortBaselineDoesNotHoldTheScale) {
  Scene scene = FourImages();
  for (int j = 0; j < 7; ++j) scene.cam_from_world[7 + j] = scene.cam_from_world[j];
  scene.cam_from_world[7 + 4] += 1e-4;
  const std::vector<uint8_t> held = Held(scene.View());
  EXPECT_EQ(held[0], FreeParameters::kWholePose);
  EXPECT_EQ(held[1], 0);
  EXPECT_EQ(__builtin_popcount(held[2]), 1);
}

/// Whatever the origin of the world: the rotation first.
TEST(GaugeHold, FarOriginsChangeNothing) {
  const Scene near = FourImages();
  Scene far = near;
  for (int i = 0; i < far.num_images(); ++i) {
    double* const pose = &far.cam_from_world[7 * static_cast<size_t>(i)];
    const double shift[3] = {200, -100, 50};
    double rotation[9], moved[3];
    QuaternionToRotation(pose, rotation);
    MatrixVector3(rotation, shift, moved);
    for (int j = 0; j < 3; ++j) pose[4 + j] -= moved[j];
  }
  for (size_t k = 0; k < far.points.size(); ++k) {
    far.points[k] += k % 3 == 0 ? 200 : k % 3 == 1 ? -100 : 50;
  }
  for (const int count : {0, 1, 2}) {
    EXPECT_EQ(Held(far.View(), HoldPoints(far, count)), Held(near.View(), HoldPoints(near, count)));
  }
}

/// An image that turns about its centre, and one whose rotation is held.
TEST(GaugeHold, PartsOfImages) {
  const Scene scene = FourImages();
  AdjustmentProblem problem = scene.View();
  const auto degrees = [&](std::vector<uint8_t> parts) {
    problem.restrictions.held_pose_parts = parts.data();
    const std::vector<uint8_t> held = Held(problem);
    int count = 0;
    for (const uint8_t bits : held) count += __builtin_popcount(bits);
    return count;
  };
  EXPECT_EQ(degrees({kHeldPosition, 0, 0, 0}), 4);
  EXPECT_EQ(degrees({0, kHeldPosition, kHeldPosition, 0}), 1);
  EXPECT_EQ(degrees({0, kHeldPosition, kHeldPosition, kHeldPosition}), 0);
  EXPECT_EQ(degrees({kHeldRotation, 0, 0, 0}), 4);
  EXPECT_EQ(degrees({kHeldRotation, kHeldPosition, 0, 0}), 1);
  EXPECT_EQ(degrees({kHeldRotation | kHeldPosition, 0, 0, 0}), 1);
}

/// (w, t) of a pose while the world turns about the centre of the cameras.
TEST(GaugeHold, MovesAreThoseOfTheChart) {
  const Scene scene = FourImages();
  const AdjustmentProblem problem = scene.View();
  const FreeParameters free = SelectFreeParameters(problem, {});
  const FreeMotions motions(problem, free);
  using Eigen::Vector3d;
  using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  std::vector<Matrix3> rotations(4);
  std::vector<Vector3d> centres;
  Vector3d middle = Vector3d::Zero();
  for (int i = 0; i < 4; ++i) {
    const double* const pose = ValueOfPose(problem, i);
    QuaternionToRotation(pose, rotations[i].data());
    centres.emplace_back(-rotations[i].transpose() * Eigen::Map<const Vector3d>(pose + 4));
    middle += centres.back() / 4;
  }
  double squared = 0;
  for (const Vector3d& centre : centres) squared += (centre - middle).squaredNorm() / 4;
  Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(7, 1);  // b = (0.3, -0.2, 0.5)
  const Vector3d b(0.3, -0.2, 0.5);
  turn.block<3, 1>(3, 0) = b;
  for (int i = 0; i < 4; ++i) {
    const Eigen::MatrixXd moves = motions.MovesOf(i, turn).chart;
    // R' c' + t' = 0 with R' = R - R [b]x and c' = c + b x (c - middle)
    const Vector3d w = -rotations[i] * b;
    const Vector3d t = rotations[i] * (b.cross(centres[i]) - b.cross(centres[i] - middle));
    EXPECT_LT((moves.topRows<3>() - w).norm(), 1e-12);
    EXPECT_LT((moves.bottomRows<3>() - t / std::sqrt(squared)).norm(), 1e-12);
  }
}

TEST(GaugeHold, ThreePointsBeginWithThoseThatAreHeld) {
  const Scene scene = FourImages();
  const auto held_points = [&](const SolveOptions& options) {
    FreeParameters free = SelectFreeParameters(scene.View(), options);
    EXPECT_EQ(FixGauge(scene.View(), Gauge::kThreePoints, &free), "");
    EXPECT_EQ(free.pose, std::vector<uint8_t>(4, FreeParameters::kWholePose));
    EXPECT_EQ(CountGaugeDegrees(scene.View(), free), 0);
    return std::count(free.point.begin(), free.point.end(), 0);
  };
  for (const int count : {0, 1, 2, 3}) EXPECT_EQ(held_points(HoldPoints(scene, count)), 3);
  Scene line = scene;
  for (int j = 0; j < 3; ++j) {
    line.points[6 + j] = line.points[j] + 0.3 * (line.points[3 + j] - line.points[j]);
  }
  FreeParameters free = SelectFreeParameters(line.View(), HoldPoints(line, 3));
  EXPECT_EQ(FixGauge(line.View(), Gauge::kThreePoints, &free), "");
  EXPECT_EQ(CountGaugeDegrees(line.View(), free), 0);
  free = SelectFreeParameters(scene.View(), {});
  free.pose[0] = 0;
  EXPECT_NE(FixGauge(scene.View(), Gauge::kThreePoints, &free), "");
  EXPECT_EQ(std::count(free.point.begin(), free.point.end(), 0), 0);
  EXPECT_EQ(CountGaugeDegrees(scene.View(), free), 0);
}

}  // namespace
}  // namespace bundle
