#pragma once

/// Small seeded scenes: cameras on a ring that look at a cloud of points, and ways to make them
/// ugly.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/cameras/registry.h"
#include "core/geometry/rotation.h"
#include "core/interface/adjustment_problem.h"
#include "core/parallel/thread_pool.h"
#include "core/scratch/large_vector.h"
#include "core/sums/point_sections.h"
#include "support/camera_params.h"

namespace bundle {

/// For EXPECT_EQ of an array of the core and one of a test.
template <typename T>
bool operator==(const LargeVector<T>& a, const std::vector<T>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end());
}

}  // namespace bundle

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
  std::vector<double> rig_from_world;  ///< empty without rigs, as are all below
  std::vector<double> sensor_from_rig;
  std::vector<int32_t> image_frame;
  std::vector<int32_t> image_sensor;
  std::vector<int64_t> frame_ids;
  std::vector<int64_t> frame_rig_ids;
  std::vector<int64_t> sensor_rig_ids;
  std::vector<int64_t> sensor_camera_ids;

  int num_images() const { return static_cast<int>(image_ids.size()); }
  int num_cameras() const { return static_cast<int>(camera_ids.size()); }
  int num_points() const { return static_cast<int>(point_ids.size()); }
  int64_t num_observations() const { return static_cast<int64_t>(observation_image.size()); }

  /// Points into this scene: not to outlive it, nor a change of its sizes.
  AdjustmentProblem View() const {
    AdjustmentProblem view;
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
    if (frame_ids.empty()) return view;
    view.num_frames = static_cast<int>(frame_ids.size());
    view.num_sensors = static_cast<int>(sensor_rig_ids.size());
    view.rig_from_world = rig_from_world.data();
    view.sensor_from_rig = sensor_from_rig.data();
    view.image_frame = image_frame.data();
    view.image_sensor = image_sensor.data();
    view.frame_ids = frame_ids.data();
    view.frame_rig_ids = frame_rig_ids.data();
    view.sensor_rig_ids = sensor_rig_ids.data();
    view.sensor_camera_ids = sensor_camera_ids.data();
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
  double perturbation = 1e-2;  ///< noise of poses and points at the start
  double outlier_share = 0;    ///< share of outliers among the observations, 50 pixels and more off
  uint64_t seed = 1;
};

namespace internal {

class SceneMaker {
 public:
  explicit SceneMaker(const SceneOptions& options)
      : options_(options),
        random_(options.seed),
        model_(FindCameraModel(options.model)),
        order_(options.num_images) {}

  Scene Make() {
    for (int i = 0; i < options_.num_images; ++i) AddImage(i);
    const int num_cameras = options_.num_images == 0 ? 0 : scene_.image_camera.back() + 1;
    for (int c = 0; c < num_cameras; ++c) AddCamera(c);
    std::iota(order_.begin(), order_.end(), 0);
    for (int p = 0; p < options_.num_points; ++p) AddPoint(p);
    for (size_t i = 0; i < scene_.cam_from_world.size(); ++i) {
      if (i % 7 >= 4) scene_.cam_from_world[i] += Perturbation();
    }
    return std::move(scene_);
  }

 private:
  double Uniform() { return std::uniform_real_distribution<double>(-1, 1)(random_); }
  double Normal() { return normal_(random_); }
  double Perturbation() { return options_.perturbation * Normal(); }

  /// On the ring; the true rotation, the perturbed one in the scene.
  void AddImage(int i) {
    const double angle = 1.2 * i / std::max(options_.num_images - 1, 1) - 0.6;
    const double turn[3] = {0.1 * Uniform(), angle, 0.1 * Uniform()};
    const double w[3] = {Perturbation(), Perturbation(), Perturbation()};
    double rotation[9], left_jacobian[9], truth[4], change[4], start[4];
    ExpRotation(turn, rotation, left_jacobian);
    rotations_.insert(rotations_.end(), rotation, rotation + 9);
    ExpQuaternion(turn, truth);
    ExpQuaternion(w, change);
    QuaternionProduct(change, truth, start);
    scene_.cam_from_world.insert(scene_.cam_from_world.end(), start, start + 4);
    scene_.cam_from_world.insert(scene_.cam_from_world.end(),
                                 {0.1 * angle, -0.1 * angle, 4 + 0.3 * angle});
    scene_.image_ids.push_back(1 + 2 * i);
    scene_.image_camera.push_back(i / options_.images_per_camera);
  }

  void AddCamera(int c) {
    scene_.camera_ids.push_back(101 + 2 * c);
    scene_.camera_models.push_back(model_);
    std::vector<double> params = UsualParams(*model_);
    params.resize(Scene::kStride);
    scene_.camera_params.insert(scene_.camera_params.end(), params.begin(), params.end());
  }

  /// And its observations, in `track_length` images drawn.
  void AddPoint(int p) {
    const double point[3] = {Uniform(), Uniform(), Uniform()};
    std::shuffle(order_.begin(), order_.end(), random_);
    const int track = options_.track_length > 0
                          ? std::min(options_.track_length, options_.num_images)
                          : options_.num_images;
    std::sort(order_.begin(), order_.begin() + track);
    for (int k = 0; k < track; ++k) Observe(order_[k], p, point);
    scene_.point_ids.push_back(1001 + 2 * p);
    for (const double x : point) scene_.points.push_back(x + Perturbation());
  }

  void Observe(int image, int p, const double* point) {
    const double* translation = &scene_.cam_from_world[7 * static_cast<size_t>(image) + 4];
    double in_camera[3], xy[2] = {};
    MatrixVector3(&rotations_[9 * static_cast<size_t>(image)], point, in_camera);
    for (int j = 0; j < 3; ++j) in_camera[j] += translation[j];
    const auto camera = static_cast<size_t>(scene_.image_camera[image]);
    model_->project(&scene_.camera_params[camera * Scene::kStride], in_camera, xy, nullptr,
                    nullptr);
    const bool outlier = 0.5 * (Uniform() + 1) < options_.outlier_share;
    for (double pixel : xy) {
      pixel += options_.noise * Normal();
      const double distance = 50 + 100 * std::abs(Normal());
      if (outlier) pixel += std::copysign(distance, Uniform());
      scene_.observation_xy.push_back(pixel);
    }
    scene_.observation_image.push_back(image);
    scene_.observation_point.push_back(p);
  }

  const SceneOptions& options_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
  const CameraModel* const model_;
  std::vector<int> order_;  ///< order of the images
  std::vector<double> rotations_;
  Scene scene_;
};

}  // namespace internal

/// Image ids count from 1, camera ids from 101, point ids from 1001, in steps of 2 to be no
/// indices. Observations are sorted by point.
inline Scene MakeScene(const SceneOptions& options) { return internal::SceneMaker(options).Make(); }

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

/// Gives the cameras these models in turn, with usual parameters. The pixels stay.
inline void SetModels(const std::vector<std::string>& names, Scene* scene) {
  for (size_t c = 0; c < scene->camera_models.size(); ++c) {
    const CameraModel* const model = FindCameraModel(names[c % names.size()]);
    const std::vector<double> params = UsualParams(*model);
    scene->camera_models[c] = model;
    std::copy(params.begin(), params.end(), &scene->camera_params[c * Scene::kStride]);
  }
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

/// Makes rigs of the images: images i, i + n, i + 2 n, ... are one sensor's, with one camera, and
/// those of a frame are n in a row, for the rig 7 with n = `num_sensors`. `last_alone`: the last
/// frame's images keep poses of their own. Sensor k stands k times `baseline` beside the reference
/// and is turned; poses of images follow from those of the first of their frame. The pixels stay.
inline void MakeRigs(int num_sensors, double baseline, bool last_alone, Scene* scene) {
  const int num_frames = scene->num_images() / num_sensors - (last_alone ? 1 : 0);
  for (int k = 0; k < num_sensors; ++k) {
    const double turn[3] = {0.02 * k, -0.03 * k, 0.01 * k};
    double q[4];
    ExpQuaternion(turn, q);
    if (k == 0) continue;
    scene->sensor_from_rig.insert(scene->sensor_from_rig.end(), q, q + 4);
    const double t[3] = {-baseline * k, 0.1 * baseline * k, -0.05 * baseline * k};
    scene->sensor_from_rig.insert(scene->sensor_from_rig.end(), t, t + 3);
    scene->sensor_rig_ids.push_back(7);
    scene->sensor_camera_ids.push_back(scene->camera_ids[k]);
  }
  for (int i = 0; i < scene->num_images(); ++i) {
    const int frame = i / num_sensors, sensor = i % num_sensors - 1;
    scene->image_camera[i] = i % num_sensors;
    const bool alone = frame >= num_frames;
    scene->image_frame.push_back(alone ? -1 : frame);
    scene->image_sensor.push_back(alone ? -1 : sensor);
    if (alone) continue;
    double* const pose = &scene->cam_from_world[7 * static_cast<size_t>(i)];
    if (sensor < 0) {
      scene->frame_ids.push_back(31 + 2 * frame);
      scene->frame_rig_ids.push_back(7);
      scene->rig_from_world.insert(scene->rig_from_world.end(), pose, pose + 7);
      continue;
    }
    const double* const s = &scene->sensor_from_rig[7 * static_cast<size_t>(sensor)];
    const double* const f = &scene->rig_from_world[7 * static_cast<size_t>(frame)];
    double rotation[9];
    QuaternionToRotation(s, rotation);
    QuaternionProduct(s, f, pose);
    MatrixVector3(rotation, f + 4, pose + 4);
    for (int j = 0; j < 3; ++j) pose[4 + j] += s[4 + j];
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

/// Sections of the points of a problem.
inline std::vector<uint16_t> SectionsOf(const ProblemView& problem, int num_threads) {
  ThreadPool pool(num_threads);
  const auto found =
      FindPointSections(problem.num_images, problem.num_points, problem.num_observations,
                        problem.observation_image, problem.observation_point, &pool);
  return {found.begin(), found.end()};
}

}  // namespace bundle::testing
