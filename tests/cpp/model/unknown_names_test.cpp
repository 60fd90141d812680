#include "core/model/unknown_names.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "core/cameras/registry.h"

namespace bundle {
namespace {

TEST(Words, NameAnyUnknownById) {
  const std::vector<int64_t> images = {1, 2, 3}, frames = {7}, cameras = {1, 2}, points = {4};
  const std::vector<int64_t> sensors = {5};
  const CameraModel* const pinhole = FindCameraModel("PINHOLE");
  AdjustmentProblem problem;
  problem.image_ids = images.data();
  problem.frame_ids = frames.data();
  problem.sensor_camera_ids = sensors.data();
  problem.camera_ids = cameras.data();
  problem.point_ids = points.data();
  problem.camera_models = {pinhole, pinhole};
  const std::vector<std::pair<UnknownName, std::string>> cases = {
      {{UnknownName::kImage, 1, 4}, "translation y of image 2"},
      {{UnknownName::kFrame, 0, 2}, "rotation z of frame 7"},
      {{UnknownName::kSensor, 0, 0}, "rotation x of the sensor of camera 5"},
      {{UnknownName::kCamera, 1, 0}, "fx of camera 2"},
      {{UnknownName::kTwist, 2, 1}, "twist wy of image 3"},
      {{UnknownName::kTwist, 2, 3}, "twist vx of image 3"},
      {{UnknownName::kReadout, 0, 0}, "readout of camera 1"},
      {{UnknownName::kPoint, 0, 2}, "z of point 4"},
  };
  for (const auto& [name, words] : cases) EXPECT_EQ(Words(problem, name), words);
}

}  // namespace
}  // namespace bundle
