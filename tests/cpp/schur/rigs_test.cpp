/// Rigs of several sensors in the elimination, against dense algebra in extended precision.

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "schur/capturing_solver.h"
#include "schur/schur_comparison.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::SceneOptions;

struct RigOptions {
  int num_sensors = 2;
  int num_images = 6;
  int num_points = 16;
  int track_length = 4;
  bool last_alone = false;
};

Scene MakeRigScene(const RigOptions& options) {
  SceneOptions scene_options;
  scene_options.num_images = options.num_images;
  scene_options.num_points = options.num_points;
  scene_options.track_length = options.track_length;
  scene_options.outlier_share = 0.1;
  Scene scene = MakeScene(scene_options);
  testing::MakeRigs(options.num_sensors, 0.2, options.last_alone, &scene);
  return scene;
}

TEST(SchurProblemWithRigs, WhateverIsFixed) {
  for (const int num_sensors : {2, 3}) {
    RigOptions rig_options;
    rig_options.num_sensors = num_sensors;
    rig_options.last_alone = num_sensors == 2;
    const Scene scene = MakeRigScene(rig_options);
    for (int bits = 0; bits < 32; ++bits) {
      SCOPED_TRACE(::testing::Message() << num_sensors << " " << bits);
      SolveOptions options = Options();
      options.loss = bits % 2 == 0 ? LossType::kTrivial : LossType::kCauchy;
      options.refine_sensor_from_rig = bits & 1;
      options.refine_poses = (bits & 2) == 0;
      options.refine_focal = options.refine_extra = (bits & 4) == 0;
      if (bits & 8) {
        options.fixed_image_ids = {scene.image_ids[1]};
        options.fixed_sensors = {{7, scene.camera_ids[1]}};
        options.fixed_point_ids.assign(scene.point_ids.begin(), scene.point_ids.begin() + 5);
      }
      if (bits & 16) options.gauge = Gauge::kTwoCameras;
      Comparison comparison(scene, options, bits % 3 != 0);
      CheckAlongTheWay(&comparison);
    }
  }
}

/// Images of a frame see a point twice, models of the sensors have different widths, images of a
/// frame are far apart in the order of the problem, and a frame has one image only.
TEST(SchurProblemWithRigs, UglyScenes) {
  RigOptions rig_options;
  rig_options.num_sensors = 3;
  std::vector<Scene> scenes(4, MakeRigScene(rig_options));
  testing::RepeatObservations(2, &scenes[0]);
  testing::SetModels({"SIMPLE_RADIAL", "FULL_OPENCV", "SIMPLE_PINHOLE"}, &scenes[1]);
  testing::ShuffleObservations(3, &scenes[2]);
  for (int32_t& image : scenes[3].observation_image) {
    if (image == 1 || image == 2) image = 4;
  }
  int index = 0;
  for (const Scene& scene : scenes) {
    for (const bool dense : {true, false}) {
      SCOPED_TRACE(::testing::Message() << "scene " << index << " " << dense);
      SolveOptions options = Options();
      options.refine_sensor_from_rig = true;
      options.refine_principal_point = true;
      options.loss = LossType::kHuber;
      Comparison comparison(scene, options, dense);
      CheckAlongTheWay(&comparison);
    }
    ++index;
  }
}

/// Points that several chunks share, and frames in most of them: no bit depends on the threads.
TEST(SchurProblemWithRigs, SameBitsForAnyNumberOfThreads) {
  RigOptions rig_options;
  rig_options.num_sensors = 3;
  rig_options.num_images = 30;
  rig_options.num_points = 400;
  rig_options.track_length = 9;
  const Scene scene = MakeRigScene(rig_options);
  const AdjustmentProblem problem = scene.View();
  for (const bool refine_sensors : {false, true}) {
    std::vector<testing::RealMatrix> matrices;
    std::vector<RealVector> right_sides;
    for (const int threads : {1, 2, 4, 4, 4}) {
      SolveOptions options = Options();
      options.num_threads = threads;
      options.refine_sensor_from_rig = refine_sensors;
      const PreparedSolve prepared = PrepareSolve(problem, options);
      const BlockStructure structure = Structure(problem, prepared.layout, true);
      CapturingSolver solver(structure);
      SchurProblem schur(problem, prepared.layout, options, structure, &solver);
      schur.Linearize(1e-4);
      schur.SolveNewton(0.1);
      matrices.push_back(solver.matrix);
      right_sides.push_back(solver.rhs);
    }
    for (size_t k = 1; k < matrices.size(); ++k) {
      EXPECT_TRUE(matrices[k] == matrices[0]) << k;
      EXPECT_TRUE(right_sides[k] == right_sides[0]) << k;
    }
  }
}

}  // namespace
}  // namespace bundle
