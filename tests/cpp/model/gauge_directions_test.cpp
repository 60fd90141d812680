#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/camera_states.h"
#include "core/model/free_parameters.h"
#include "core/model/gauge.h"
#include "core/model/parameter_layout.h"
#include "support/scene.h"

namespace bundle {
namespace {

using Eigen::Vector3d;

constexpr int kCount = BlockSystem::kNumGaugeDirections;

Vector3d InCamera(const PoseState& pose, const Vector3d& point) {
  using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  return Eigen::Map<const Matrix3>(pose.rotation) * point +
         Eigen::Map<const Vector3d>(pose.translation);
}

Vector3d Centre(const CameraStates& cameras, int num_images) {
  using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  Vector3d sum = Vector3d::Zero();
  for (int i = 0; i < num_images; ++i) {
    sum -= Eigen::Map<const Matrix3>(cameras.pose(i).rotation).transpose() *
           Eigen::Map<const Vector3d>(cameras.pose(i).translation);
  }
  return sum / num_images;
}

/// The velocity of a point under similarity m of the world.
Vector3d Velocity(int m, const Vector3d& point, const Vector3d& centre) {
  if (m < 3) return Vector3d::Unit(m);
  if (m < 6) return Vector3d::Unit(m - 3).cross(point - centre);
  return point - centre;
}

/// Points seen in a moved world by moved cameras appear where they did, to first order: what is
/// left over falls with the square of the step. Far from the start, where the chart is curved.
TEST(GaugeDirections, ChangeNoImage) {
  const testing::Scene scene = testing::MakeScene({});
  const AdjustmentProblem view = scene.View();
  const ParameterLayout layout(view, SelectFreeParameters(view, SolveOptions{}));
  std::vector<double> state = layout.InitialState(view);
  for (const CameraBlock& block : layout.blocks()) {
    for (int k = 0; k < 3; ++k) state[block.offset + k] = 0.4 * (k + 1) - 0.5;
  }
  CameraStates cameras(view, layout);
  cameras.Update(state.data());
  const std::vector<double> gauge_directions = GaugeDirections(view, layout, cameras);
  ASSERT_EQ(gauge_directions.size(), state.size() * kCount);
  const Vector3d centre = Centre(cameras, view.num_images);

  const auto residual = [&](int m, double step) {
    std::vector<double> moved = state;
    for (size_t k = 0; k < state.size(); ++k) moved[k] += step * gauge_directions[k * kCount + m];
    CameraStates moved_cameras(view, layout);
    moved_cameras.Update(moved.data());
    double largest = 0;
    for (int i = 0; i < view.num_images; ++i) {
      for (int p = 0; p < view.num_points; ++p) {
        const Vector3d point(view.points + 3 * static_cast<size_t>(p));
        const Vector3d before = InCamera(cameras.pose(i), point);
        const Vector3d after =
            InCamera(moved_cameras.pose(i), point + step * Velocity(m, point, centre));
        largest = std::max(largest, (after / after.z() - before / before.z()).norm());
      }
    }
    return largest;
  };
  for (int m = 0; m < kCount; ++m) {
    const double coarse = residual(m, 1e-3), fine = residual(m, 1e-4);
    EXPECT_LE(fine, 0.02 * coarse + 1e-12) << m;
    EXPECT_LE(fine, 1e-5) << m;
  }
}

TEST(GaugeDirections, LeaveIntrinsicsAlone) {
  const testing::Scene scene = testing::MakeScene({});
  const AdjustmentProblem view = scene.View();
  const ParameterLayout layout(view, SelectFreeParameters(view, SolveOptions{}));
  const std::vector<double> gauge_directions =
      GaugeDirections(view, layout, CameraStates(view, layout));
  int num_moved = 0;
  for (const CameraBlock& block : layout.blocks()) {
    for (int k = 0; k < block.size; ++k) {
      const double* const row = &gauge_directions[static_cast<size_t>(block.offset + k) * kCount];
      const bool moves = std::any_of(row, row + kCount, [](double v) { return v != 0; });
      EXPECT_EQ(moves, block.columns[k] < kPoseSize);
      num_moved += moves;
    }
  }
  EXPECT_EQ(num_moved, kPoseSize * view.num_images);
}

}  // namespace
}  // namespace bundle
