/// Part of FreeMotions (gauge_count.h): equations [delta_i, -M_s] of the images that move by one
/// pose (derived in gauge_count.cpp).

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/geometry/rotation.h"
#include "core/model/gauge.h"
#include "core/model/gauge_count.h"
#include "core/model/parameter_layout.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Map6 = Eigen::Matrix<double, 6, 6>;
using RowMajor6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

}  // namespace

/// A pose at the start values, about the origin of the world.
PoseState FreeMotions::StartOf(int pose) const {
  const double* const value = ValueOfPose(problem_, pose);
  PoseState state;
  QuaternionToRotation(value, state.rotation);
  std::copy_n(value + 4, 3, state.translation);
  std::copy_n(kIdentity3, 9, state.left_jacobian);
  return state;
}

/// A pose about the centre of the cameras.
PoseState FreeMotions::Centered(int pose) const {
  PoseState state = StartOf(pose);
  double moved[3];
  MatrixVector3(state.rotation, centre_.data(), moved);
  for (int j = 0; j < 3; ++j) state.translation[j] += moved[j];
  return state;
}

/// Map from (w, t) of a pose in the world to its local coordinates about the centre.
Map6 FreeMotions::ChartMap(int pose, const PoseState& centered) const {
  double arm[3], by_turn[9];
  const bool turns = pose < problem_.num_images && TurnsAboutCentre(problem_, pose);
  MatrixVector3(centered.rotation, centre_.data(), arm);
  MinusCross(turns ? centered.translation : arm, kIdentity3, by_turn);
  RowMajor6 map;
  JoinBlocks(kIdentity3, nullptr, by_turn, kIdentity3, map.data());
  return map;
}

/// The free columns of a map, with lengths in units of the scene.
MatrixXd FreeMotions::FreeColumns(Map6 map, uint8_t bits) const {
  map.bottomRows<3>() /= size_;
  map.rightCols<3>() *= size_;
  MatrixXd columns(6, __builtin_popcount(bits));
  int next = 0;
  for (int j = 0; j < kPoseSize; ++j) {
    if (bits >> j & 1u) columns.col(next++) = map.col(j);
  }
  return columns;
}

uint8_t FreeMotions::BitsOf(int pose) const {
  return pose < problem_.num_images ? free_.pose[pose] : free_.frame[pose - problem_.num_images];
}

/// `own`: the map of its frame. `on_rig` becomes the map of its sensor, if it has one.
RigPose FreeMotions::OnRig(int image, const PoseState& own, PoseState* on_rig) const {
  const int sensor = problem_.SensorOf(image);
  if (sensor < 0) return {&own, nullptr};
  *on_rig = StartOf(PoseOfSensor(problem_, sensor));
  return {&own, on_rig};
}

/// [delta_i, -M_s] of the images that share one pose: those of a frame, or a single image.
FreeMotions::Equations FreeMotions::EquationsOf(int pose, const std::vector<int>& images) const {
  const PoseState own = Centered(pose);
  Equations equations;
  std::vector<int>& columns = equations.columns;
  for (int k = 0; k < kNumGaugeDirections; ++k) columns.push_back(k);
  std::vector<int> sensors;
  for (const int i : images) {
    const int sensor = problem_.SensorOf(i);
    if (sensor < 0 || std::count(sensors.begin(), sensors.end(), sensor) > 0) continue;
    sensors.push_back(sensor);
    for (int k = 0; k < __builtin_popcount(free_.sensor[sensor]); ++k) {
      columns.push_back(kNumGaugeDirections + first_column_[sensor] + k);
    }
  }
  MatrixXd& wanted = equations.wanted;
  wanted.setZero(static_cast<Eigen::Index>(6 * images.size()),
                 static_cast<Eigen::Index>(columns.size()));
  for (size_t k = 0; k < images.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(6 * k);
    PoseState on_rig, image = own;
    if (pose >= problem_.num_images) {
      const RigPose rig = OnRig(images[k], own, &on_rig);
      if (rig.sensor != nullptr) {
        const int sensor = problem_.SensorOf(images[k]);
        const uint8_t bits = free_.sensor[sensor];
        const auto at =
            std::find(columns.begin(), columns.end(), kNumGaugeDirections + first_column_[sensor]);
        RowMajor6 map;
        SensorMap(rig, map.data());
        if (bits != 0) {
          wanted.block(row, at - columns.begin(), 6, __builtin_popcount(bits)) =
              -FreeColumns(map, bits);
        }
      }
      ComposePose(rig, &image);
    }
    const Matrix3 rotation = Eigen::Map<const Matrix3>(image.rotation);
    wanted.block<3, 3>(row + 3, 0) = -rotation;
    wanted.block<3, 3>(row, 3) = -rotation;
    wanted.block<3, 1>(row + 3, 6) = Eigen::Map<const Vector3d>(image.translation) / size_;
  }
  return equations;
}

}  // namespace bundle
