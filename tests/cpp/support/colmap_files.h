#pragma once

/// The files of a COLMAP model with the scene's cameras, images and points, in both formats, as
/// COLMAP's documentation describes them; rigs and frames as COLMAP makes them for a model that has
/// none.

#include <cstdint>
#include <cstdio>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "core/cameras/registry.h"
#include "support/scene.h"

namespace bundle::testing {

/// By file name.
using Files = std::map<std::string, std::string>;

namespace internal {

template <typename T>
void Put(T value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof value);
}

inline std::string Text(double value) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, " %.17g", value);
  return buffer;
}

/// The observations of each image, whose positions are the keypoints'.
inline std::vector<std::vector<int64_t>> KeypointsOf(const Scene& scene) {
  std::vector<std::vector<int64_t>> keypoints(scene.num_images());
  for (int64_t i = 0; i < scene.num_observations(); ++i) {
    keypoints[scene.observation_image[i]].push_back(i);
  }
  return keypoints;
}

/// (image, keypoint) of the track of each point.
inline std::vector<std::vector<std::pair<int, uint32_t>>> TracksOf(const Scene& scene) {
  std::vector<std::vector<std::pair<int, uint32_t>>> tracks(scene.num_points());
  std::vector<uint32_t> num_keypoints(scene.num_images());
  for (int64_t i = 0; i < scene.num_observations(); ++i) {
    const int image = scene.observation_image[i];
    tracks[scene.observation_point[i]].emplace_back(image, num_keypoints[image]++);
  }
  return tracks;
}

/// qw qx qy qz tx ty tz
inline std::vector<double> PoseInFile(const Scene& scene, int image) {
  const double* pose = &scene.cam_from_world[7 * static_cast<size_t>(image)];
  return {pose[3], pose[0], pose[1], pose[2], pose[4], pose[5], pose[6]};
}

inline const double* ParamsOf(const Scene& scene, int camera) {
  return &scene.camera_params[static_cast<size_t>(camera) * Scene::kStride];
}

}  // namespace internal

inline Files BinaryColmapFiles(const Scene& scene) {
  using internal::Put;
  std::string cameras, images, points, rigs, frames;
  Put<uint64_t>(scene.camera_ids.size(), &cameras);
  Put<uint64_t>(scene.camera_ids.size(), &rigs);
  for (int c = 0; c < scene.num_cameras(); ++c) {
    const auto id = static_cast<uint32_t>(scene.camera_ids[c]);
    const CameraModel* model = scene.camera_models[c];
    Put(id, &cameras);
    Put(static_cast<int32_t>(model - AllCameraModels()), &cameras);
    Put<uint64_t>(800, &cameras);
    Put<uint64_t>(600, &cameras);
    for (int j = 0; j < model->num_params; ++j) Put(internal::ParamsOf(scene, c)[j], &cameras);
    Put(id, &rigs);
    Put<uint32_t>(1, &rigs);
    Put<int32_t>(0, &rigs);
    Put(id, &rigs);
  }
  Put<uint64_t>(scene.image_ids.size(), &images);
  Put<uint64_t>(scene.image_ids.size(), &frames);
  const auto keypoints = internal::KeypointsOf(scene);
  for (int i = 0; i < scene.num_images(); ++i) {
    const auto id = static_cast<uint32_t>(scene.image_ids[i]);
    const auto camera_id = static_cast<uint32_t>(scene.camera_ids[scene.image_camera[i]]);
    Put(id, &images);
    Put(id, &frames);
    Put(camera_id, &frames);  // the rig
    for (const double value : internal::PoseInFile(scene, i)) {
      Put(value, &images);
      Put(value, &frames);
    }
    Put<uint32_t>(1, &frames);
    Put<int32_t>(0, &frames);
    Put(camera_id, &frames);
    Put<uint64_t>(id, &frames);
    Put(camera_id, &images);
    images += "image" + std::to_string(id) + ".jpg";
    images += '\0';
    Put<uint64_t>(keypoints[i].size(), &images);
    for (const int64_t k : keypoints[i]) {
      Put(scene.observation_xy[2 * k], &images);
      Put(scene.observation_xy[2 * k + 1], &images);
      Put(static_cast<uint64_t>(scene.point_ids[scene.observation_point[k]]), &images);
    }
  }
  Put<uint64_t>(scene.point_ids.size(), &points);
  const auto tracks = internal::TracksOf(scene);
  for (int p = 0; p < scene.num_points(); ++p) {
    Put(static_cast<uint64_t>(scene.point_ids[p]), &points);
    for (int j = 0; j < 3; ++j) Put(scene.points[3 * static_cast<size_t>(p) + j], &points);
    points += "rgb";
    Put(0.5, &points);
    Put<uint64_t>(tracks[p].size(), &points);
    for (const auto& [image, keypoint] : tracks[p]) {
      Put(static_cast<uint32_t>(scene.image_ids[image]), &points);
      Put(keypoint, &points);
    }
  }
  return {{"cameras.bin", cameras},
          {"images.bin", images},
          {"points3D.bin", points},
          {"rigs.bin", rigs},
          {"frames.bin", frames}};
}

inline Files TextColmapFiles(const Scene& scene) {
  using internal::Text;
  std::string cameras = "# cameras\n", images = "# images\n", points = "# points\n";
  std::string rigs = "# rigs\n", frames = "# frames\n";
  for (int c = 0; c < scene.num_cameras(); ++c) {
    const std::string id = std::to_string(scene.camera_ids[c]);
    const CameraModel* model = scene.camera_models[c];
    cameras += id + " " + model->name + " 800 600";
    for (int j = 0; j < model->num_params; ++j) cameras += Text(internal::ParamsOf(scene, c)[j]);
    cameras += "\n";
    rigs += id + " 1 CAMERA " + id + "\n";
  }
  const auto keypoints = internal::KeypointsOf(scene);
  for (int i = 0; i < scene.num_images(); ++i) {
    const std::string id = std::to_string(scene.image_ids[i]);
    const std::string camera_id = std::to_string(scene.camera_ids[scene.image_camera[i]]);
    std::string pose;
    for (const double value : internal::PoseInFile(scene, i)) pose += Text(value);
    images += id + pose + " " + camera_id + " image" + id + ".jpg\n";
    for (const int64_t k : keypoints[i]) {
      images += Text(scene.observation_xy[2 * k]) + Text(scene.observation_xy[2 * k + 1]) + " " +
                std::to_string(scene.point_ids[scene.observation_point[k]]);
    }
    images += "\n";
    frames += id + " " + camera_id + pose + " 1 CAMERA " + camera_id + " " + id + "\n";
  }
  const auto tracks = internal::TracksOf(scene);
  for (int p = 0; p < scene.num_points(); ++p) {
    points += std::to_string(scene.point_ids[p]);
    for (int j = 0; j < 3; ++j) points += Text(scene.points[3 * static_cast<size_t>(p) + j]);
    points += " 1 2 3 0.5";
    for (const auto& [image, keypoint] : tracks[p]) {
      points += " " + std::to_string(scene.image_ids[image]) + " " + std::to_string(keypoint);
    }
    points += "\n";
  }
  return {{"cameras.txt", cameras},
          {"images.txt", images},
          {"points3D.txt", points},
          {"rigs.txt", rigs},
          {"frames.txt", frames}};
}

}  // namespace bundle::testing
