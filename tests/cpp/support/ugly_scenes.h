#pragma once

#include <string>
#include <utility>
#include <vector>

#include "support/scene.h"

namespace bundle::testing {

/// Problems that are valid, and that no solver is glad of.
inline std::vector<std::pair<std::string, Scene>> UglyScenes() {
  std::vector<std::pair<std::string, Scene>> scenes;
  const auto add = [&](const char* name, const SceneOptions& options) -> Scene* {
    scenes.emplace_back(name, MakeScene(options));
    return &scenes.back().second;
  };
  const SceneOptions usual;
  SceneOptions one_image, two_points, seen_once, shared;
  one_image.num_images = 1;
  two_points.num_points = 2;
  seen_once.track_length = 1;
  shared.model = "OPENCV_FISHEYE";
  shared.images_per_camera = 3;
  scenes.emplace_back("nothing", Scene());
  add("one image", one_image);
  add("two points", two_points);
  add("points seen once", seen_once);
  PutPointsBehind(4, add("some points behind", usual));
  PutPointsBehind(1, add("all points behind", usual));
  RepeatObservations(3, add("repeated observations", usual));
  ShuffleObservations(5, add("observations in no order", usual));
  AddUnobserved(add("an image and a point unobserved", usual));
  Append(MakeScene(usual), add("two pieces of two models", shared));
  Scene* scene = add("one point many times", usual);
  scene->points.assign(scene->points.size(), 0);
  scene = add("points far away", usual);
  scene->points.assign(scene->points.size(), 1e200);
  scene = add("pixels far away", usual);
  scene->observation_xy.assign(scene->observation_xy.size(), 1e160);
  scene = add("cameras in one place", usual);
  for (size_t i = 0; i < scene->cam_from_world.size(); ++i) {
    scene->cam_from_world[i] = scene->cam_from_world[i % 7];
  }
  return scenes;
}

}  // namespace bundle::testing
