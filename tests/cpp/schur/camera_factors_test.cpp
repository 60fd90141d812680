#include "core/schur/camera_factors.h"

#include <gtest/gtest.h>

#include "schur/schur_comparison.h"
#include "support/some_factors.h"

namespace bundle {
namespace {

using testing::FactorMaker;
using testing::Kind;
using testing::SmallScene;

TEST(CameraFactors, AddToTheNormalEquationsWhatDenseAlgebraSays) {
  for (const int images_per_camera : {1, 2, 4}) {
    const Scene scene = SmallScene(images_per_camera);
    for (const auto& [name, loss] : kLossTypes) {
      for (const bool dense : {true, false}) {
        SCOPED_TRACE(::testing::Message() << name << ", " << images_per_camera << ", " << dense);
        FactorMaker maker(scene);
        maker.AddAll(loss, scene.num_cameras());
        const ProblemFactors factors = maker.Take();
        Comparison comparison(scene, Options(), dense, &factors);
        CheckAlongTheWay(&comparison);
      }
    }
  }
}

TEST(CameraFactors, HeldColumnsVanishAndTheirCostCounts) {
  const Scene scene = SmallScene(2);
  FactorMaker maker(scene);
  maker.AddAll(LossType::kHuber, scene.num_cameras());
  const ProblemFactors factors = maker.Take();
  for (int bits = 0; bits < 32; ++bits) {
    SCOPED_TRACE(bits);
    SolveOptions options = Options();
    options.refine_poses = !(bits & 1);
    options.refine_focal = !(bits & 2);
    options.refine_extra = !(bits & 4);
    options.refine_points = !(bits & 16);
    if (bits & 8) {
      options.fixed_image_ids = {scene.image_ids[1], scene.image_ids[2]};
      options.fixed_camera_ids = {scene.camera_ids[0]};
      options.fixed_point_ids = {scene.point_ids[5]};
    }
    Comparison comparison(scene, options, bits % 3 != 0, &factors);
    CheckAlongTheWay(&comparison);
  }
}

TEST(CameraFactors, OfWhatNoObservationSees) {
  Scene scene = SmallScene(1);
  const int image = scene.num_images(), camera = scene.num_cameras(), point = scene.num_points();
  testing::AddUnobserved(&scene);
  scene.camera_ids.push_back(77);
  scene.camera_models.push_back(scene.camera_models[0]);
  scene.camera_params.insert(scene.camera_params.end(), scene.camera_params.begin(),
                             scene.camera_params.begin() + Scene::kStride);
  scene.image_camera.back() = camera;
  ASSERT_GT(scene.num_images(), image);
  FactorMaker maker(scene);
  maker.Prior(Kind::kImage, image, LossType::kTrivial);
  maker.Between(Kind::kImage, 1, image, LossType::kCauchy);
  maker.Prior(Kind::kCamera, camera, LossType::kTrivial);
  maker.Prior(Kind::kPoint, point, LossType::kTrivial);
  const ProblemFactors factors = maker.Take();
  for (const bool dense : {true, false}) {
    Comparison comparison(scene, Options(), dense, &factors);
    EXPECT_EQ(comparison.layout().num_free_points(), point + 1);
    EXPECT_GE(comparison.layout().image_block(image), 0);
    EXPECT_GE(comparison.layout().camera_block(camera), 0);
    CheckAlongTheWay(&comparison);
  }
}

}  // namespace
}  // namespace bundle
