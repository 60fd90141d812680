#include "core/schur/image_parts.h"

#include <gtest/gtest.h>

#include <set>

#include "core/prepare/prepare.h"
#include "support/scene.h"

namespace bundle {
namespace {

testing::Scene SceneOf(int images_per_camera) {
  testing::SceneOptions options;
  options.num_images = 6;
  options.images_per_camera = images_per_camera;
  return testing::MakeScene(options);
}

/// The parts of a scene for some options.
struct Parts {
  explicit Parts(const testing::Scene& scene, const SolveOptions& options = {})
      : problem(scene.View()),
        layout(PrepareSolve(problem, options).layout),
        parts(problem, layout) {}

  int Of(int image, PartKind kind) const { return parts.part_of(image, kind); }

  AdjustmentProblem problem;
  ParameterLayout layout;
  ImageParts parts;
};

TEST(ImageParts, AnImageWithItsOwnCameraIsOnePart) {
  const testing::Scene scene = SceneOf(1);
  SolveOptions options;
  options.gauge = Gauge::kNone;
  const Parts found(scene, options);
  EXPECT_EQ(found.parts.num_parts(), 6);
  EXPECT_EQ(found.parts.num_own_parts(), 6);
  EXPECT_EQ(found.parts.num_kinds(), 1);
  std::set<int> seen;
  for (int i = 0; i < 6; ++i) {
    EXPECT_TRUE(seen.insert(found.Of(i, kOwnPart)).second);
    EXPECT_EQ(found.Of(i, kCameraPart), -1);
  }
  EXPECT_EQ(found.parts.part(0).num_columns, 8);  // pose, focal length, one distortion
  EXPECT_EQ(found.parts.own_quads(), 2);
  EXPECT_EQ(found.parts.camera_quads(), 0);
}

TEST(ImageParts, ACameraThatImagesShareIsAPart) {
  const testing::Scene scene = SceneOf(3);
  const Parts found(scene);
  EXPECT_EQ(found.parts.num_parts(), 6 + 2);
  EXPECT_EQ(found.parts.num_kinds(), 2);
  for (int i = 0; i < 6; ++i) {
    EXPECT_EQ(found.Of(i, kCameraPart), found.Of(i / 3 * 3, kCameraPart));
    EXPECT_GE(found.Of(i, kCameraPart), found.parts.num_own_parts());
  }
  EXPECT_EQ(found.parts.part(found.Of(0, kOwnPart)).num_columns, 6);
  EXPECT_EQ(found.parts.part(found.Of(0, kCameraPart)).num_columns, 2);
  EXPECT_EQ(found.parts.own_quads(), 2);
  EXPECT_EQ(found.parts.camera_quads(), 1);
  EXPECT_EQ(found.parts.record_columns(), 12);
}

TEST(ImageParts, OwnPartsAreInTheOrderOfTheirBlocks) {
  const testing::Scene scene = SceneOf(3);
  Parts found(scene);
  std::vector<int> reversed;
  for (auto b = static_cast<int>(found.layout.blocks().size()); b-- > 0;) reversed.push_back(b);
  found.layout.Reorder(reversed);
  const ImageParts parts(found.problem, found.layout);
  for (int i = 0; i + 1 < 6; ++i) {
    const bool before = found.layout.image_block(i) < found.layout.image_block(i + 1);
    EXPECT_EQ(parts.part_of(i, kOwnPart) < parts.part_of(i + 1, kOwnPart), before);
  }
}

TEST(ImageParts, ConstantParametersAreNoPart) {
  const testing::Scene scene = SceneOf(3);
  SolveOptions options;
  options.fixed_image_ids = {scene.image_ids[2]};
  options.fixed_camera_ids = {scene.camera_ids[1]};
  const Parts found(scene, options);
  EXPECT_EQ(found.Of(2, kOwnPart), -1);
  EXPECT_GE(found.Of(2, kCameraPart), 0);
  EXPECT_GE(found.Of(3, kOwnPart), 0);
  EXPECT_EQ(found.Of(3, kCameraPart), -1);
  options.refine_poses = options.refine_focal = options.refine_extra = false;
  const Parts none(scene, options);
  EXPECT_EQ(none.parts.num_parts(), 0);
  EXPECT_EQ(none.parts.image_refined(), std::vector<uint8_t>(6, 0));
}

TEST(ImageParts, ImagesOfAFrameShareItsPoseAndThoseOfASensorItsPose) {
  testing::Scene scene = SceneOf(1);
  testing::SetModels({"SIMPLE_RADIAL", "FULL_OPENCV"}, &scene);
  testing::MakeRigs(2, 0.2, /*last_alone=*/false, &scene);
  SolveOptions options;
  options.refine_sensor_from_rig = true;
  const Parts found(scene, options);
  std::set<int> sensors;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      if (found.Of(i, kOwnPart) < 0 || found.Of(j, kOwnPart) < 0) continue;
      EXPECT_EQ(found.Of(i, kOwnPart) == found.Of(j, kOwnPart),
                found.problem.FrameOf(i) == found.problem.FrameOf(j));
    }
    if (found.Of(i, kOwnPart) >= 0) {
      EXPECT_EQ(found.parts.part(found.Of(i, kOwnPart)).num_columns, 6);
    }
    if (found.Of(i, kSensorPart) >= 0) {
      sensors.insert(found.Of(i, kSensorPart));
      EXPECT_EQ(found.parts.part(found.Of(i, kSensorPart)).num_columns, 6);
    }
  }
  EXPECT_EQ(sensors.size(), 1u);  // the other is the reference
  EXPECT_EQ(found.parts.num_kinds(), 3);
  EXPECT_EQ(found.parts.own_quads(), 0);  // several kinds of records
}

/// Images of a frame have records of equal width for its pose, even if the gauge holds a number of
/// this pose and the other images of one of the models are of a constant frame.
TEST(ImageParts, RecordsOfAFrameAreAsWideAsItsPart) {
  testing::Scene scene = SceneOf(1);
  testing::SetModels({"SIMPLE_RADIAL", "FULL_OPENCV"}, &scene);
  testing::MakeRigs(2, 0.2, /*last_alone=*/false, &scene);
  scene.image_camera[5] = 0;  // images 1 and 3 alone have the second model
  SolveOptions options;
  options.refine_sensor_from_rig = true;  // otherwise the rig has a length
  options.gauge = Gauge::kTwoCameras;
  const Parts found(scene, options);
  const int held = found.layout.blocks_of(3)[ParameterLayout::kPoseBlock];
  ASSERT_EQ(found.layout.blocks()[held].size, 5);
  for (const int i : {2, 3}) {
    const ModelGroup& group = found.parts.groups()[found.parts.image_group()[i]];
    EXPECT_EQ(group.parts[kOwnPart].num_columns, 6) << i;
    EXPECT_EQ(found.parts.part(found.Of(i, kOwnPart)).num_columns, 6);
  }
  EXPECT_EQ(found.Of(0, kOwnPart), -1);
}

}  // namespace
}  // namespace bundle
