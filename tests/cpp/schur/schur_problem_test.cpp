#include "core/schur/schur_problem.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "schur/capturing_solver.h"
#include "schur/schur_comparison.h"
#include "support/no_threads.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::SceneOptions;

SceneOptions SmallScene() {
  SceneOptions options;
  options.num_images = 4;
  options.num_points = 14;
  options.track_length = 3;
  options.outlier_share = 0.1;
  return options;
}

class SchurProblemTest : public ::testing::TestWithParam<int> {};

TEST_P(SchurProblemTest, EqualsDenseAlgebraInExtendedPrecision) {
  for (const int images_per_camera : {1, 2, 4}) {
    SceneOptions scene_options = SmallScene();
    scene_options.model = AllCameraModels()[GetParam()].name;
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (const auto& [name, loss] : kLossTypes) {
      SCOPED_TRACE(::testing::Message() << name << ", " << images_per_camera);
      SolveOptions options = Options();
      options.loss = loss;
      options.refine_principal_point = images_per_camera == 2;
      Comparison comparison(scene, options, images_per_camera != 4);
      CheckAlongTheWay(&comparison);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, SchurProblemTest, ::testing::Range(0, kNumCameraModels),
                         [](const auto& test) { return AllCameraModels()[test.param].name; });

TEST(SchurProblem, WhateverIsFixed) {
  SceneOptions scene_options = SmallScene();
  for (const int images_per_camera : {1, 2}) {
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (int bits = 1; bits < 64; ++bits) {
      SCOPED_TRACE(::testing::Message() << bits << ", " << images_per_camera);
      SolveOptions options = Options();
      options.refine_poses = bits & 1;
      options.refine_points = bits & 2;
      options.refine_focal = bits & 4;
      options.refine_principal_point = bits & 8;
      options.refine_extra = bits & 16;
      if (bits & 32) {
        options.fixed_image_ids = {scene.image_ids[0], scene.image_ids[2]};
        options.fixed_camera_ids = {scene.camera_ids[0]};
        options.fixed_point_ids.assign(scene.point_ids.begin(), scene.point_ids.begin() + 7);
      }
      Comparison comparison(scene, options, bits % 3 != 0);
      CheckAlongTheWay(&comparison);
    }
  }
}

TEST(SchurProblem, EveryGauge) {
  for (const auto& [name, gauge] : kGauges) {
    SCOPED_TRACE(name);
    SolveOptions options = Options();
    options.gauge = gauge;
    const Scene scene = MakeScene(SmallScene());
    Comparison comparison(scene, options);
    CheckAlongTheWay(&comparison);
  }
}

TEST(SchurProblem, UglyScenes) {
  std::vector<Scene> scenes(8, MakeScene(SmallScene()));
  testing::RepeatObservations(3, &scenes[0]);
  testing::RepeatObservations(1, &scenes[1]);
  testing::ShuffleObservations(3, &scenes[1]);
  testing::PutPointsBehind(3, &scenes[2]);
  testing::PutPointsBehind(1, &scenes[3]);
  testing::AddUnobserved(&scenes[4]);
  SceneOptions fisheye = SmallScene();
  fisheye.model = "OPENCV_FISHEYE";
  fisheye.images_per_camera = 4;
  testing::Append(MakeScene(fisheye), &scenes[5]);  // two models, own and shared intrinsics
  SceneOptions once = SmallScene();
  once.track_length = 1;
  testing::Append(MakeScene(once), &scenes[6]);  // points seen once
  SceneOptions one_image = SmallScene();
  one_image.num_images = 1;
  scenes[7] = MakeScene(one_image);
  int index = 0;
  for (const Scene& scene : scenes) {
    for (const auto& [name, cheirality] : kCheiralities) {
      for (const bool dense : {true, false}) {
        SCOPED_TRACE(::testing::Message() << "scene " << index << " " << name << " " << dense);
        SolveOptions options = Options();
        options.cheirality = cheirality;
        options.loss = LossType::kCauchy;
        Comparison comparison(scene, options, dense);
        comparison.Check(1e-2);
        comparison.Check(1);
      }
    }
    ++index;
  }
}

/// Jacobian rows of 1 to 6 quads, of which two models share one: points that images of one width
/// see, and others.
TEST(SchurProblem, MixedWidths) {
  const std::vector<std::string> models = {"SIMPLE_RADIAL", "RAD_TAN_THIN_PRISM_FISHEYE",
                                           "SIMPLE_PINHOLE", "FULL_OPENCV", "OPENCV"};
  SceneOptions scene_options;
  scene_options.num_images = 11;
  scene_options.num_points = 40;
  scene_options.track_length = 3;
  for (const int images_per_camera : {1, 2}) {
    scene_options.images_per_camera = images_per_camera;
    Scene scene = MakeScene(scene_options);
    testing::SetModels(models, &scene);
    testing::RepeatObservations(7, &scene);
    for (int bits = 0; bits < 8; ++bits) {
      SCOPED_TRACE(::testing::Message() << images_per_camera << ", " << bits);
      SolveOptions options = Options();
      options.loss = LossType::kCauchy;
      options.refine_poses = bits & 1;
      options.refine_principal_point = bits & 2;
      if (bits & 4) {
        options.fixed_image_ids.push_back(scene.image_ids[3]);
        // Without poses, nothing is refined of the images that see some of the points.
        for (size_t c = 1; c < scene.camera_ids.size(); c += 2) {
          options.fixed_camera_ids.push_back(scene.camera_ids[c]);
        }
        options.fixed_point_ids.assign(scene.point_ids.begin(), scene.point_ids.begin() + 9);
      }
      Comparison comparison(scene, options, bits % 3 != 0);
      comparison.Check(1e-2);
      comparison.Step();
      comparison.Check(1);
    }
  }
}

/// So many images see a point that it is spread over several chunks, and there are several of
/// those for each thread.
TEST(SchurProblem, LongTracksAndManyChunks) {
  SceneOptions scene_options;
  scene_options.num_images = 40;
  scene_options.num_points = 60;
  for (const int images_per_camera : {1, 40}) {
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (const int threads : {1, 3}) {
      SCOPED_TRACE(::testing::Message() << images_per_camera << " " << threads);
      SolveOptions options = Options();
      options.num_threads = threads;
      options.refine_principal_point = true;
      Comparison comparison(scene, options);
      comparison.Check(1e-3);
    }
  }
}

/// Threads that wait for a chunk that never comes end as well, and the next pass starts anew.
TEST(SchurProblem, CanBeInterruptedAndGoesOn) {
  SceneOptions scene_options;
  scene_options.num_images = 40;
  scene_options.num_points = 200;
  for (const int images_per_camera : {1, 40}) {
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    const AdjustmentProblem problem = scene.View();
    SolveOptions options = Options();
    options.num_threads = 4;
    const PreparedSolve prepared = PrepareSolve(problem, options);
    std::vector<int> sizes;
    for (const CameraBlock& block : prepared.layout.blocks()) sizes.push_back(block.size);
    const BlockStructure structure = DenseStructure(sizes);
    CapturingSolver solver(structure);
    SchurProblem schur(problem, prepared.layout, options, structure, &solver);
    const Linearization expected = schur.Linearize(1e-4);
    ASSERT_TRUE(expected.is_finite);
    for (int i = 0; i < 20; ++i) {
      {
        const InterruptionScope scope([] { return true; });
        EXPECT_THROW(schur.Linearize(1e-4), Interrupted);
      }
      const Linearization again = schur.Linearize(1e-4);
      EXPECT_EQ(again.cost, expected.cost);
      EXPECT_EQ(again.gradient_norm, expected.gradient_norm);
    }
  }
}

TEST(SchurProblem, NeedsNoSecondThread) {
  const Scene scene = MakeScene(SmallScene());
  const testing::NoThreads none;
  Comparison comparison(scene, Options());
  CheckAlongTheWay(&comparison);
}

}  // namespace
}  // namespace bundle
