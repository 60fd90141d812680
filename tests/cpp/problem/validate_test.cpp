#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>

#include "core/error.h"
#include "core/problem/problem_view.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr int32_t kMaxIndex = std::numeric_limits<int32_t>::max();
constexpr int32_t kMinIndex = std::numeric_limits<int32_t>::min();

Scene SmallScene() {
  SceneOptions options;
  options.num_images = 3;
  options.num_points = 4;
  return MakeScene(options);
}

/// Message of ValidateProblem for a problem; "" if it is valid.
std::string Complaint(const ProblemView& problem) {
  try {
    ValidateProblem(problem);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

std::string ComplaintAfter(const std::function<void(Scene*)>& damage) {
  Scene scene = SmallScene();
  damage(&scene);
  return Complaint(scene.View());
}

TEST(ValidateProblem, AcceptsWhatIsSound) {
  EXPECT_EQ(Complaint(SmallScene().View()), "");
  EXPECT_EQ(Complaint(Scene().View()), "");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { testing::RepeatObservations(1, s); }), "");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { testing::AddUnobserved(s); }), "");
  // Whoever needs the model says so.
  EXPECT_EQ(ComplaintAfter([](Scene* s) {
              s->camera_models[1] = nullptr;
              s->camera_params[Scene::kStride] = kNan;
            }),
            "");
  // Beyond the parameters of the model there may be anything.
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->camera_params[Scene::kStride - 1] = kNan; }), "");
}

TEST(ValidateProblem, FindsTheFirstAndTheLastOfWhatIsNotFinite) {
  for (const double bad : {kNan, kInf, -kInf}) {
    for (const size_t at : {size_t{0}, size_t{13}, size_t{20}}) {
      const std::string image = "image " + std::to_string(1 + 2 * (at / 7));
      EXPECT_EQ(
          ComplaintAfter([&](Scene* s) { s->cam_from_world[at] = bad; }).find(image + ": expected"),
          0u);
    }
    for (const size_t at : {size_t{0}, size_t{11}}) {
      const std::string point = "point " + std::to_string(1001 + 2 * (at / 3));
      EXPECT_EQ(ComplaintAfter([&](Scene* s) { s->points[at] = bad; }).find(point + ": expected"),
                0u);
    }
    for (const size_t at : {size_t{0}, size_t{23}}) {
      const std::string row = "observation " + std::to_string(at / 2) + " (image ";
      EXPECT_EQ(ComplaintAfter([&](Scene* s) { s->observation_xy[at] = bad; }).find(row), 0u);
    }
    for (const size_t j : {size_t{0}, size_t{3}}) {
      EXPECT_EQ(ComplaintAfter([&](Scene* s) {
                  s->camera_params[2 * Scene::kStride + j] = bad;
                }).find("camera 105: expected a finite"),
                0u);
    }
  }
}

TEST(ValidateProblem, FindsIndicesOutOfRange) {
  for (const int32_t bad : {-1, kMaxIndex, kMinIndex}) {
    EXPECT_NE(ComplaintAfter([&](Scene* s) { s->observation_image.back() = bad; }), "");
    EXPECT_NE(ComplaintAfter([&](Scene* s) { s->observation_point.back() = bad; }), "");
    EXPECT_NE(ComplaintAfter([&](Scene* s) { s->image_camera.back() = bad; }), "");
  }
  // One past the end.
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->observation_image[11] = 3; }),
            "observation 11: expected an image index below 3, found 3");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->observation_point[0] = 4; }),
            "observation 0: expected a point index below 4, found 4");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->image_camera[1] = 3; }),
            "image 3: expected a camera index below 3, found 3");
}

TEST(ValidateProblem, FindsRepeatedIds) {
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->image_ids = {9, 4, 9}; }),
            "image 9: expected unique ids, found this id twice");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->camera_ids = {-1, -1, 0}; }),
            "camera -1: expected unique ids, found this id twice");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->point_ids = {4, 3, 2, 4}; }),
            "point 4: expected unique ids, found this id twice");
  EXPECT_EQ(ComplaintAfter([](Scene* s) { s->point_ids = {4, 3, 2, 1}; }), "");
}

TEST(ValidateProblem, FindsWhatIsNoRotation) {
  const auto quaternion = [](double size) {
    return ComplaintAfter([&](Scene* s) {
      for (int j = 0; j < 4; ++j) s->cam_from_world[7 + j] = size;
    });
  };
  for (const double size : {0.0, 1e-200, 1e200, 1e308}) {
    EXPECT_EQ(quaternion(size).find("image 3: expected a rotation"), 0u) << size;
  }
  for (const double size : {1e-100, 1.0, -5.0, 1e100}) EXPECT_EQ(quaternion(size), "") << size;
}

std::string ComplaintOfRigsAfter(const std::function<void(Scene*)>& damage) {
  SceneOptions options;
  options.num_images = 6;
  options.num_points = 4;
  Scene scene = MakeScene(options);
  testing::MakeRigs(2, 0.3, /*last_alone=*/true, &scene);
  damage(&scene);
  return Complaint(scene.View());
}

TEST(ValidateProblem, FindsWhatIsNoRig) {
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene*) {}), "");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_frame[1] = 2; }),
            "image 3: expected a frame index from -1 to 1, found 2");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_frame[1] = -2; }),
            "image 3: expected a frame index from -1 to 1, found -2");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_sensor[1] = 1; }),
            "image 3: expected a sensor index from -1 to 0, found 1");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_sensor[1] = -2; }),
            "image 3: expected a sensor index from -1 to 0, found -2");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_frame[1] = -1; }),
            "image 3: expected a frame for its sensor, found -1");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->image_camera[3] = 0; }),
            "image 7: expected camera 103 of its sensor, found camera 101");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->frame_ids[1] = 31; }),
            "frame 31: expected unique ids, found this id twice");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->rig_from_world[12] = kNan; }),
            "frame 33: expected a finite pose, found nan");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) { s->sensor_from_rig[4] = kInf; }),
            "sensor_from_rig: rig 7, camera 103: expected a finite pose, found inf");
  EXPECT_EQ(ComplaintOfRigsAfter([](Scene* s) {
              for (int j = 0; j < 7; ++j) s->sensor_from_rig.push_back(s->sensor_from_rig[j]);
              s->sensor_rig_ids.push_back(7);
              s->sensor_camera_ids.push_back(103);
            }),
            "sensor_from_rig: rig 7, camera 103: expected every sensor once, found twice");
}

TEST(ValidateProblem, FindsWhatIsNoLens) {
  for (const double focal : {0.0, -0.0, -800.0}) {
    EXPECT_EQ(ComplaintAfter([&](Scene* s) {
                s->camera_params[0] = focal;
              }).find("camera 101: expected a positive focal length f, found"),
              0u);
  }
  Scene sphere = MakeScene([] {
    SceneOptions options;
    options.model = "EQUIRECTANGULAR";
    return options;
  }());
  EXPECT_EQ(Complaint(sphere.View()), "");
  sphere.camera_params[1] = -1000;
  EXPECT_EQ(Complaint(sphere.View()), "camera 101: expected a positive image size h, found -1000");

  const Scene scene = SmallScene();
  ProblemView narrow = scene.View();
  narrow.camera_params_stride = 3;
  EXPECT_EQ(Complaint(narrow), "camera 101: expected 4 parameters of SIMPLE_RADIAL, found 3");
}

}  // namespace
}  // namespace bundle
