#include "core/factors/rig_pose.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace bundle {
namespace {

/// A chart: the rotation it is about, and (v, t).
struct Chart {
  double anchor[9], x[6];

  PoseState Expand(const double* step = nullptr, double scale = 0) const {
    double moved[6];
    for (int j = 0; j < 6; ++j) moved[j] = x[j] + (step == nullptr ? 0 : scale * step[j]);
    PoseState pose;
    ExpandPose(anchor, moved, &pose);
    return pose;
  }
};

class RigPoseTest : public ::testing::Test {
 protected:
  double Uniform() { return std::uniform_real_distribution<double>(-1, 1)(random_); }

  Chart Draw() {
    Chart chart;
    const double turn[3] = {2 * Uniform(), 2 * Uniform(), 2 * Uniform()};
    double unused[9];
    ExpRotation(turn, chart.anchor, unused);
    for (double& x : chart.x) x = 1.5 * Uniform();
    return chart;
  }

  std::mt19937_64 random_{3};
};

/// (phi, tau) that takes one pose to another.
void LocalDifference(const PoseState& from, const PoseState& to, double* local) {
  double back[9], turn[9];
  for (int i = 0; i < 9; ++i) back[i] = from.rotation[3 * (i % 3) + i / 3];
  MatrixProduct3(to.rotation, back, turn);
  local[0] = (turn[7] - turn[5]) / 2;  // small: sine and angle are the same
  local[1] = (turn[2] - turn[6]) / 2;
  local[2] = (turn[3] - turn[1]) / 2;
  for (int i = 0; i < 3; ++i) local[3 + i] = to.translation[i] - from.translation[i];
}

TEST_F(RigPoseTest, MapsAreDerivatives) {
  constexpr double kStep = 1e-5;
  for (int repeat = 0; repeat < 20; ++repeat) {
    const Chart frame = Draw(), sensor = Draw();
    for (const bool is_reference : {false, true}) {
      for (const bool moves_sensor : {false, true}) {
        if (is_reference && moves_sensor) continue;
        const PoseState f = frame.Expand(), s = sensor.Expand();
        const RigPose rig = {&f, is_reference ? nullptr : &s};
        double map[36];
        moves_sensor ? SensorMap(rig, map) : FrameMap(rig, map);
        for (int j = 0; j < 6; ++j) {
          double unit[6] = {}, local[6];
          unit[j] = 1;
          PoseState image[2];
          for (const int side : {0, 1}) {
            const double h = side == 0 ? -kStep : kStep;
            const PoseState moved_f = frame.Expand(unit, moves_sensor ? 0 : h);
            const PoseState moved_s = sensor.Expand(unit, moves_sensor ? h : 0);
            ComposePose({&moved_f, is_reference ? nullptr : &moved_s}, &image[side]);
          }
          LocalDifference(image[0], image[1], local);
          for (int i = 0; i < 6; ++i) {
            EXPECT_NEAR(map[6 * i + j], local[i] / (2 * kStep), 1e-8) << i << " " << j;
          }
        }
      }
    }
  }
}

TEST_F(RigPoseTest, SensorsMoveAsFramesWould) {
  for (int repeat = 0; repeat < 20; ++repeat) {
    const PoseState f = Draw().Expand(), s = Draw().Expand();
    const RigPose rig = {&f, &s};
    double by_frame[36], by_sensor[36], k[36];
    FrameMap(rig, by_frame);
    SensorMap(rig, by_sensor);
    SensorByFrameMap(rig, k);
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) {
        double sum = 0;
        for (int m = 0; m < 6; ++m) sum += by_frame[6 * i + m] * k[6 * m + j];
        EXPECT_NEAR(sum, by_sensor[6 * i + j], 1e-13) << i << " " << j;
      }
    }
  }
}

}  // namespace
}  // namespace bundle
