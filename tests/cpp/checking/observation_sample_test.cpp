#include <gtest/gtest.h>

#include <cstdint>
#include <numeric>
#include <vector>

#include "core/checking/check_solution.h"
#include "support/scene.h"

namespace bundle {
namespace {

/// Every image sees every point.
testing::Scene Dense(int num_images, int num_points) {
  testing::SceneOptions options;
  options.num_images = num_images;
  options.num_points = num_points;
  return testing::MakeScene(options);
}

/// Observations of each image.
std::vector<int> Drawn(const testing::Scene& scene, int64_t size) {
  std::vector<int> drawn(scene.num_images());
  for (const int64_t i : SampleObservations(scene.View(), size)) {
    ++drawn[scene.observation_image[i]];
  }
  return drawn;
}

TEST(SampleObservations, EachImageHasItsShare) {
  const testing::Scene scene = Dense(10, 100);
  for (const int drawn : Drawn(scene, 200)) EXPECT_NEAR(drawn, 20, 1);
}

/// Images that would draw less than one each begin anywhere, so that some draw one.
TEST(SampleObservations, ManyImagesOfFewObservationsAreNotPassedOver) {
  const testing::Scene scene = Dense(200, 5);
  const std::vector<int> drawn = Drawn(scene, 100);
  EXPECT_NEAR(std::accumulate(drawn.begin(), drawn.end(), 0), 100, 30);
}

TEST(SampleObservations, TakesAllWhereThereAreFewer) {
  const testing::Scene scene = Dense(4, 10);
  for (const int64_t size : {40, 1000}) {
    const std::vector<int64_t> sample = SampleObservations(scene.View(), size);
    ASSERT_EQ(sample.size(), 40u);
    for (int i = 0; i < 40; ++i) EXPECT_EQ(sample[i], i);
  }
}

/// Neither an image nor a camera model that observes nothing takes a share.
TEST(SampleObservations, ImagesWithoutObservationsTakeNoShare) {
  testing::Scene scene = Dense(12, 100);
  scene.camera_models[11] = FindCameraModel("PINHOLE");
  for (int32_t& image : scene.observation_image) image %= 2;
  const std::vector<int> drawn = Drawn(scene, 100);
  EXPECT_NEAR(drawn[0], 50, 1);
  EXPECT_NEAR(drawn[1], 50, 1);
}

/// One image of a model and nine of another: half of the sample each.
TEST(SampleObservations, EachModelHasItsShare) {
  testing::Scene scene = Dense(10, 300);
  scene.camera_models[0] = FindCameraModel("PINHOLE");
  const std::vector<int> drawn = Drawn(scene, 180);
  EXPECT_NEAR(drawn[0], 90, 1);
  for (int image = 1; image < 10; ++image) EXPECT_NEAR(drawn[image], 10, 1);
}

}  // namespace
}  // namespace bundle
