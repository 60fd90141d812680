#pragma once

/// Small seeded scenes: cameras on a ring that look at a cloud of points, and ways to make them
/// ugly.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "core/cameras/registry.h"
#include "core/geometry/rotation.h"
#include "core/problem/problem_view.h"
#include "support/camera_params.h"

namespace bundle::testing {

/// Owns the arrays behind a ProblemView.
struct Scene {
  static constexpr int kStride = kMaxCameraParams;

  std::vector<double> cam_from_world;  ///< as in ProblemView, here and below
  std::vector<int64_t> image_ids;
  std::vector<int32_t> image_camera;
  std::vector<int64_t> camera_ids;
  std::vector<const CameraModel*> camera_models;
  std::vector<double> camera_params;  ///< num_cameras x kStride
  std::vector<double> points;
  std::vector<int64_t> point_ids;
  std::vector<int32_t> observation_image;
  std::vector<int32_t> observation_point;
  std::vector<double> observation_xy;

  int num_images() const { return static_cast<int>(image_ids.size()); }
  int num_cameras() const { return static_cast<int>(camera_ids.size()); }
  int num_points() const { return static_cast<int>(point_ids.size()); }
  int64_t num_observations() const { return static_cast<int64_t>(observation_image.size()); }

  /// Points into this scene: not to outlive it, nor a change of its sizes.
  ProblemView View() const {
    ProblemView view;
    view.num_images = num_images();
    view.num_cameras = num_cameras();
    view.num_points = num_points();
    view.num_observations = num_observations();
    view.cam_from_world = cam_from_world.data();
    view.image_ids = image_ids.data();
    view.image_camera = image_camera.data();
    view.camera_ids = camera_ids.data();
    for (const CameraModel* model : camera_models) {
      view.camera_model_names.emplace_back(model != nullptr ? model->name : "UNKNOWN");
    }
    view.camera_models = camera_models;
    view.camera_params = camera_params.data();
    view.camera_params_stride = kStride;
    view.points = points.data();
    view.point_ids = point_ids.data();
    view.observation_image = observation_image.data();
    view.observation_point = observation_point.data();
    view.observation_xy = observation_xy.data();
    return view;
  }
};

struct SceneOptions {
  std::string model = "SIMPLE_RADIAL";
  int num_images = 5;
  int num_points = 40;
  int images_per_camera = 1;   ///< more than 1: shared intrinsics
  int track_length = 0;        ///< images that see a point; 0: all of them
  double noise = 0.5;          ///< standard deviation, pixels
  double perturbation = 1e-2;  ///< of poses and points at the start
  double outlier_share = 0;    ///< of the observations, 50 pixels and more off
  uint64_t seed = 1;
};

/// Image ids count from 1, camera ids from 101, point ids from 1001, in steps of 2 to be no
/// indices. Observations are sorted by point.
inline Scene MakeScene(const SceneOptions& options) {
  std::mt19937_64 random(options.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1, 1);
  Scene scene;
  std::vector<double> rotations;  // of the truth
  for (int i = 0; i < options.num_images; ++i) {
    const double angle = 1.2 * i / std::max(options.num_images - 1, 1) - 0.6;
    const double turn[3] = {0.1 * uniform(random), angle, 0.1 * uniform(random)};
    double rotation[9], left_jacobian[9], q[4], change[4], start[4];
    ExpRotation(turn, rotation, left_jacobian);
    rotations.insert(rotations.end(), rotation, rotation + 9);
    ExpQuaternion(turn, q);
    const double w[3] = {options.perturbation * normal(random),
                         options.perturbation * normal(random),
                         options.perturbation * normal(random)};
    ExpQuaternion(w, change);
    QuaternionProduct(change, q, start);
    scene.cam_from_world.insert(scene.cam_from_world.end(), start, start + 4);
    for (const double t : {0.1 * angle, -0.1 * angle, 4 + 0.3 * angle}) {
      scene.cam_from_world.push_back(t);
    }
    scene.image_ids.push_back(1 + 2 * i);
    scene.image_camera.push_back(i / options.images_per_camera);
  }
  const CameraModel* model = FindCameraModel(options.model);
  const int num_cameras = options.num_images == 0 ? 0 : scene.image_camera.back() + 1;
  for (int c = 0; c < num_cameras; ++c) {
    scene.camera_ids.push_back(101 + 2 * c);
    scene.camera_models.push_back(model);
    std::vector<double> params = UsualParams(*model);
    params.resize(Scene::kStride);
    scene.camera_params.insert(scene.camera_params.end(), params.begin(), params.end());
  }
  std::vector<int> order(options.num_images);
  for (int i = 0; i < options.num_images; ++i) order[i] = i;
  const int track = options.track_length > 0 ? std::min(options.track_length, options.num_images)
                                             : options.num_images;
  for (int p = 0; p < options.num_points; ++p) {
    const double point[3] = {uniform(random), uniform(random), uniform(random)};
    scene.point_ids.push_back(1001 + 2 * p);
    std::shuffle(order.begin(), order.end(), random);
    std::sort(order.begin(), order.begin() + track);
    for (int k = 0; k < track; ++k) {
      const int image = order[k];
      double in_camera[3], xy[2] = {};
      MatrixVector3(&rotations[9 * static_cast<size_t>(image)], point, in_camera);
      for (int j = 0; j < 3; ++j) {
        in_camera[j] += scene.cam_from_world[7 * static_cast<size_t>(image) + 4 + j];
      }
      const int camera = scene.image_camera[image];
      model->project(&scene.camera_params[static_cast<size_t>(camera) * Scene::kStride], in_camera,
                     xy, nullptr, nullptr);
      const bool outlier = 0.5 * (uniform(random) + 1) < options.outlier_share;
      for (double& pixel : xy) {
        pixel += options.noise * normal(random);
        if (outlier) pixel += std::copysign(50 + 100 * std::abs(normal(random)), normal(random));
        scene.observation_xy.push_back(pixel);
      }
      scene.observation_image.push_back(image);
      scene.observation_point.push_back(p);
    }
    for (const double x : point) scene.points.push_back(x + options.perturbation * normal(random));
  }
  for (int i = 0; i < options.num_images; ++i) {
    for (int j = 4; j < 7; ++j) {
      scene.cam_from_world[7 * static_cast<size_t>(i) + j] += options.perturbation * normal(random);
    }
  }
  return scene;
}

/// Adds another scene that shares nothing with this one: a piece of its own.
inline void Append(const Scene& other, Scene* scene) {
  const int num_images = scene->num_images(), num_cameras = scene->num_cameras();
  const int num_points = scene->num_points();
  const auto append = [](const auto& from, auto offset, auto* to) {
    for (const auto& value : from) to->push_back(value + offset);
  };
  append(other.cam_from_world, 0, &scene->cam_from_world);
  append(other.image_ids, 1'000'000, &scene->image_ids);
  append(other.image_camera, num_cameras, &scene->image_camera);
  append(other.camera_ids, 1'000'000, &scene->camera_ids);
  append(other.camera_models, 0, &scene->camera_models);
  append(other.camera_params, 0, &scene->camera_params);
  append(other.points, 0, &scene->points);
  append(other.point_ids, 1'000'000, &scene->point_ids);
  append(other.observation_image, num_images, &scene->observation_image);
  append(other.observation_point, num_points, &scene->observation_point);
  append(other.observation_xy, 0, &scene->observation_xy);
}

/// Moves every `step`th point far out, behind some of the cameras on the ring.
inline void PutPointsBehind(int step, Scene* scene) {
  for (int p = 0; p < scene->num_points(); p += step) {
    scene->points[3 * static_cast<size_t>(p)] += 0.5;
    scene->points[3 * static_cast<size_t>(p) + 2] -= 8;
  }
}

/// Repeats every `step`th observation at the end, with its pixels moved a little.
inline void RepeatObservations(int step, Scene* scene) {
  const int64_t count = scene->num_observations();
  for (int64_t i = 0; i < count; i += step) {
    const int32_t image = scene->observation_image[i], point = scene->observation_point[i];
    const double x = scene->observation_xy[2 * i], y = scene->observation_xy[2 * i + 1];
    scene->observation_image.push_back(image);
    scene->observation_point.push_back(point);
    scene->observation_xy.push_back(x + 0.25);
    scene->observation_xy.push_back(y - 0.25);
  }
}

/// Puts the observations into a random order.
inline void ShuffleObservations(uint64_t seed, Scene* scene) {
  std::mt19937_64 random(seed);
  std::vector<int64_t> order(scene->num_observations());
  for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int64_t>(i);
  std::shuffle(order.begin(), order.end(), random);
  const Scene before = *scene;
  for (size_t i = 0; i < order.size(); ++i) {
    const int64_t from = order[i];
    scene->observation_image[i] = before.observation_image[from];
    scene->observation_point[i] = before.observation_point[from];
    for (int j = 0; j < 2; ++j)
      scene->observation_xy[2 * i + j] = before.observation_xy[2 * from + j];
  }
}

/// An image and a point without observations; the image has the camera of the first one.
inline void AddUnobserved(Scene* scene) {
  for (int j = 0; j < 7; ++j) scene->cam_from_world.push_back(j == 3 ? 1 : 0);
  scene->image_ids.push_back(5'000'001);
  scene->image_camera.push_back(0);
  scene->points.insert(scene->points.end(), {0.1, 0.2, 0.3});
  scene->point_ids.push_back(5'000'001);
}

}  // namespace bundle::testing
