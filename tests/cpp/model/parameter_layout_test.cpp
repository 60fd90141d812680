#include "core/model/parameter_layout.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "core/geometry/rotation.h"
#include "core/interface/options.h"
#include "core/model/camera_states.h"
#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::AddUnobserved;
using testing::Append;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

SolveOptions RefineAll() {
  SolveOptions options;
  options.refine_principal_point = true;
  return options;
}

Scene SceneWith(const char* model, int num_images, int images_per_camera) {
  SceneOptions options;
  options.model = model;
  options.num_images = num_images;
  options.images_per_camera = images_per_camera;
  options.num_points = 10;
  return MakeScene(options);
}

/// Every scalar that the options leave free, as (kind, index, column): what a state has to hold,
/// each once.
std::set<std::pair<int, int>> FreeScalars(const AdjustmentProblem& problem,
                                          const FreeParameters& free) {
  std::set<std::pair<int, int>> scalars;  // images count from 0, cameras from 1000
  for (int i = 0; i < problem.num_images; ++i) {
    for (int j = 0; j < kPoseSize; ++j) {
      if (free.pose[i] >> j & 1) scalars.emplace(i, j);
    }
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    for (int j = 0; j < kMaxCameraParams; ++j) {
      if (free.camera[c] >> j & 1) scalars.emplace(1000 + c, kPoseSize + j);
    }
  }
  return scalars;
}

void CheckLayout(const Scene& scene, const FreeParameters& free, const ParameterLayout& layout);

/// Checks all that the header promises, on one problem, with its blocks in two orders.
void CheckLayout(const Scene& scene, const SolveOptions& options) {
  const AdjustmentProblem problem = scene.View();
  const FreeParameters free = SelectFreeParameters(problem, options);
  ParameterLayout layout(problem, free);
  CheckLayout(scene, free, layout);
  std::vector<int> order(layout.blocks().size());
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), std::mt19937(1));
  layout.Reorder(order);
  CheckLayout(scene, free, layout);
}

void CheckLayout(const Scene& scene, const FreeParameters& free, const ParameterLayout& layout) {
  const AdjustmentProblem problem = scene.View();
  const std::set<std::pair<int, int>> scalars = FreeScalars(problem, free);
  ASSERT_EQ(layout.state_size(), static_cast<int>(scalars.size()));

  int offset = 0;
  for (const CameraBlock& block : layout.blocks()) {
    EXPECT_EQ(block.offset, offset);
    EXPECT_GT(block.size, 0);
    for (int k = 1; k < block.size; ++k) EXPECT_LT(block.columns[k - 1], block.columns[k]);
    offset += block.size;
  }
  EXPECT_EQ(offset, layout.state_size());

  // Out: distinct numbers. Each must arrive at one place, and nothing else may change.
  std::vector<double> state(layout.state_size());
  for (size_t k = 0; k < state.size(); ++k) state[k] = 7000 + static_cast<double>(k);
  std::vector<double> poses(kPoseSize * problem.num_images, -1);
  std::vector<double> params(scene.camera_params.size(), -1);
  layout.Scatter(problem, state.data(), poses.data(), params.data(), nullptr, nullptr);
  std::set<double> arrived;
  for (int i = 0; i < problem.num_images; ++i) {
    for (int j = 0; j < kPoseSize; ++j) {
      const double value = poses[kPoseSize * i + j];
      EXPECT_EQ(value != -1, scalars.count({i, j}) == 1) << "image " << i << " column " << j;
      if (value != -1) arrived.insert(value);
    }
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    for (int j = 0; j < kMaxCameraParams; ++j) {
      const double value = params[Scene::kStride * c + j];
      EXPECT_EQ(value != -1, scalars.count({1000 + c, kPoseSize + j}) == 1)
          << "camera " << c << " parameter " << j;
      if (value != -1) arrived.insert(value);
    }
  }
  EXPECT_EQ(arrived, std::set<double>(state.begin(), state.end()));

  // Back: the initial state is the problem's own.
  CameraStates states(problem, layout);
  states.Update(layout.InitialState(problem).data());
  EXPECT_EQ(states.CamFromWorld(), scene.cam_from_world);
  EXPECT_EQ(states.camera_params(), scene.camera_params);

  // An observation's blocks hold its pose and intrinsics, shared ones apart.
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i], camera = problem.image_camera[image];
    std::set<int> columns;
    for (const int index : {layout.image_block(image), layout.camera_block(camera)}) {
      if (index < 0) continue;
      const CameraBlock& block = layout.blocks()[index];
      columns.insert(block.columns, block.columns + block.size);
    }
    std::set<int> expected;
    for (const auto& [owner, column] : scalars) {
      if (owner == image || owner == 1000 + camera) expected.insert(column);
    }
    EXPECT_EQ(columns, expected) << "observation " << i;
  }
}

TEST(ParameterLayout, HoldsEveryFreeNumberOnce) {
  for (int m = 0; m < kNumCameraModels; ++m) {
    for (const int images_per_camera : {1, 2, 4}) {
      SCOPED_TRACE(::testing::Message() << AllCameraModels()[m].name << ", " << images_per_camera);
      CheckLayout(SceneWith(AllCameraModels()[m].name, 4, images_per_camera), RefineAll());
    }
  }
}

TEST(ParameterLayout, HoldsWhatTheOptionsLeave) {
  Scene scene = SceneWith("OPENCV", 4, 1);
  Append(SceneWith("RADIAL", 4, 3), &scene);
  for (int bits = 0; bits < 32; ++bits) {
    SCOPED_TRACE(bits);
    SolveOptions options;
    options.refine_poses = bits & 1;
    options.refine_points = bits & 2;
    options.refine_focal = bits & 4;
    options.refine_principal_point = bits & 8;
    options.refine_extra = bits & 16;
    CheckLayout(scene, options);
    options.fixed_image_ids = {scene.image_ids[1], scene.image_ids[5]};
    options.fixed_camera_ids = {scene.camera_ids[0], scene.camera_ids[4]};
    options.fixed_point_ids = {scene.point_ids[3]};
    CheckLayout(scene, options);
  }
}

TEST(ParameterLayout, MergesWhatOneImageUsesAndSharesTheRest) {
  const Scene merged = SceneWith("SIMPLE_RADIAL", 3, 1);
  const ParameterLayout own(merged.View(), SelectFreeParameters(merged.View(), SolveOptions()));
  EXPECT_TRUE(own.BlocksBesideFirst().empty());
  ASSERT_EQ(own.blocks().size(), 3u);
  for (int c = 0; c < 3; ++c) EXPECT_EQ(own.camera_block(c), -1);
  for (const CameraBlock& block : own.blocks()) EXPECT_EQ(block.size, 8);  // pose, f, k

  const Scene one_camera = SceneWith("SIMPLE_RADIAL", 3, 3);
  const ParameterLayout shared(one_camera.View(),
                               SelectFreeParameters(one_camera.View(), SolveOptions()));
  EXPECT_FALSE(shared.BlocksBesideFirst().empty());
  ASSERT_EQ(shared.blocks().size(), 4u);
  EXPECT_EQ(shared.camera_block(0), 3);
  EXPECT_EQ(shared.blocks()[3].size, 2);
}

/// The camera of an image that nothing observes belongs to the image that is observed, and to it
/// alone.
TEST(ParameterLayout, AnUnobservedImageDoesNotOwnItsCamera) {
  for (const int images_per_camera : {1, 3}) {
    SCOPED_TRACE(images_per_camera);
    Scene scene = SceneWith("SIMPLE_RADIAL", 3, images_per_camera);
    AddUnobserved(&scene);
    CheckLayout(scene, RefineAll());
    const AdjustmentProblem problem = scene.View();
    const ParameterLayout layout(problem, SelectFreeParameters(problem, RefineAll()));
    EXPECT_EQ(layout.image_block(3), -1);
    EXPECT_FALSE(layout.point_is_free(problem.num_points - 1));
  }
}

/// A state whose images are turned by `angle` about different axes.
std::vector<double> Turned(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const std::vector<double>& angle) {
  const double axes[][3] = {{1, 0, 0}, {0.6, 0, -0.8}, {0, -1, 0}, {0.48, 0.64, 0.6}, {0, 0, 1}};
  std::vector<double> state = layout.InitialState(problem);
  for (int i = 0; i < problem.num_images; ++i) {
    double* const w = &state[layout.blocks()[layout.image_block(i)].offset];
    for (int j = 0; j < 3; ++j) w[j] = angle[i] * axes[i][j];
  }
  return state;
}

class MovedAnchors : public ::testing::Test {
 protected:
  static constexpr double kSlightly = 1e-9;

  double Distance(const double* a, const double* b, int n) {
    double distance = 0;
    for (int j = 0; j < n; ++j) distance = std::max(distance, std::abs(a[j] - b[j]));
    return distance;
  }

  const Scene scene_ = SceneWith("SIMPLE_RADIAL", 5, 1);
  const AdjustmentProblem problem_ = scene_.View();
  const ParameterLayout layout_{problem_, SelectFreeParameters(problem_, RefineAll())};
  const std::vector<double> angle_ = {M_PI - kSlightly, M_PI + kSlightly, 2 * M_PI, -3.14, 50};
  const std::vector<bool> moves_ = {false, true, true, false, true};
  const std::vector<double> state_ = Turned(problem_, layout_, angle_);
};

TEST_F(MovedAnchors, KeepTheStateAndThePoses) {
  CameraStates before(problem_, layout_), after(problem_, layout_);
  before.Update(state_.data());
  after.Update(state_.data());
  EXPECT_TRUE(after.MoveAnchors());
  for (int i = 0; i < problem_.num_images; ++i) {
    SCOPED_TRACE(i);
    const PoseState &a = before.pose(i), &b = after.pose(i);
    double pose[7], moved[7], chart[kPoseSize];
    before.ValueOf(i, pose);
    after.ValueOf(i, moved);
    after.Chart(i, chart);
    if (!moves_[i]) {
      EXPECT_EQ(Distance(a.rotation, b.rotation, 9), 0);
      EXPECT_EQ(Distance(a.left_jacobian, b.left_jacobian, 9), 0);
      EXPECT_EQ(Distance(pose, moved, 7), 0);
      EXPECT_GT(Distance(chart, std::vector<double>(3).data(), 3), 1);
      continue;
    }
    EXPECT_LT(Distance(a.rotation, b.rotation, 9), 1e-14);
    EXPECT_EQ(Distance(a.translation, b.translation, 3), 0);
    EXPECT_EQ(Distance(pose, moved, 7), 0);
    const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    EXPECT_EQ(Distance(b.left_jacobian, identity, 9), 0);
    EXPECT_EQ(Distance(chart, std::vector<double>(3).data(), 3), 0);
  }
  // Once is enough; and the same state stays where it is.
  EXPECT_FALSE(after.MoveAnchors());
  const std::vector<double> poses = after.CamFromWorld();
  after.Update(state_.data());
  EXPECT_EQ(after.CamFromWorld(), poses);
  after.Reset();
  EXPECT_EQ(after.CamFromWorld(), scene_.cam_from_world);
}

/// From a new anchor a step d turns by Exp(d), and J_l says what the next one does, twice.
TEST_F(MovedAnchors, AreWhereStepsStart) {
  CameraStates states(problem_, layout_);
  std::vector<double> state = state_;
  const double d[3] = {0.2, -1.1, 0.7}, length = std::sqrt(0.04 + 1.21 + 0.49);
  for (const int round : {1, 2}) {
    SCOPED_TRACE(round);
    states.Update(state.data());
    states.MoveAnchors();
    CameraStates candidate(problem_, layout_);
    candidate.SetAnchors(states.anchors());
    std::vector<double> after = state;
    for (int i = 0; i < problem_.num_images; ++i) {
      if (!moves_[i]) continue;
      double* const w = &after[layout_.blocks()[layout_.image_block(i)].offset];
      for (int j = 0; j < 3; ++j) w[j] += 2 * d[j];  // 2.6 radians: no new anchor
    }
    candidate.Update(after.data());
    EXPECT_FALSE(candidate.MoveAnchors());
    const double turn[3] = {2 * d[0], 2 * d[1], 2 * d[2]};
    double increment[9], left_jacobian[9];
    ExpRotation(turn, increment, left_jacobian);
    for (int i = 0; i < problem_.num_images; ++i) {
      if (!moves_[i]) continue;
      double expected[9];
      MatrixProduct3(increment, states.pose(i).rotation, expected);
      EXPECT_LT(Distance(candidate.pose(i).rotation, expected, 9), 1e-13) << i;
      EXPECT_LT(Distance(candidate.pose(i).left_jacobian, left_jacobian, 9), 1e-13) << i;
    }
    // On to the second: further along than one chart goes.
    for (int i = 0; i < problem_.num_images; ++i) {
      if (!moves_[i]) continue;
      double* const w = &state[layout_.blocks()[layout_.image_block(i)].offset];
      for (int j = 0; j < 3; ++j) w[j] += 4 * d[j] / length;
    }
  }
}

TEST(ParameterLayout, OfNothingIsEmpty) {
  const Scene empty;
  CheckLayout(empty, RefineAll());
  const ParameterLayout layout(empty.View(), SelectFreeParameters(empty.View(), SolveOptions()));
  EXPECT_TRUE(layout.blocks().empty());
  EXPECT_EQ(layout.num_free_points(), 0);
}

}  // namespace
}  // namespace bundle
