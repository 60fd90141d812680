#include "core/model/parameter_layout.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "core/interface/options.h"
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
std::set<std::pair<int, int>> FreeScalars(const ProblemView& problem, const FreeParameters& free) {
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
  const ProblemView problem = scene.View();
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
  const ProblemView problem = scene.View();
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
  layout.Scatter(problem, state.data(), poses.data(), params.data());
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
  EXPECT_FALSE(own.has_shared_intrinsics());
  ASSERT_EQ(own.blocks().size(), 3u);
  for (int c = 0; c < 3; ++c) EXPECT_EQ(own.camera_block(c), -1);
  for (const CameraBlock& block : own.blocks()) EXPECT_EQ(block.size, 8);  // pose, f, k

  const Scene one_camera = SceneWith("SIMPLE_RADIAL", 3, 3);
  const ParameterLayout shared(one_camera.View(),
                               SelectFreeParameters(one_camera.View(), SolveOptions()));
  EXPECT_TRUE(shared.has_shared_intrinsics());
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
    const ProblemView problem = scene.View();
    const ParameterLayout layout(problem, SelectFreeParameters(problem, RefineAll()));
    EXPECT_EQ(layout.image_block(3), -1);
    EXPECT_FALSE(layout.point_is_free(problem.num_points - 1));
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
