#include "core/io/colmap_records.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>

#include "core/cameras/camera_model.h"
#include "core/cameras/registry.h"
#include "core/io/colmap_record_file.h"

namespace bundle {
namespace {

/// Number of digits that COLMAP writes.
constexpr int kDigits = 17;

void WriteCameras(const ColmapRecords& records, bool is_binary,
                  const std::filesystem::path& folder) {
  RecordFile file(folder, "cameras", is_binary, kDigits,
                  "# Camera list with one line of data per camera:\n"
                  "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
                  "# Number of cameras: ",
                  records.cameras.size());
  for (const ColmapIndex::Camera& camera : records.cameras) {
    file.BeginRecord();
    file.Integer(camera.id);
    file.Named(static_cast<int32_t>(camera.model - AllCameraModels()), camera.model->name);
    file.Integer(camera.width);
    file.Integer(camera.height);
    for (int i = 0; i < camera.model->num_params; ++i) {
      file.Number(camera.params[static_cast<size_t>(i)]);
    }
  }
  file.Close();
}

void WriteImages(const ColmapRecords& records, bool is_binary, const std::filesystem::path& folder,
                 size_t num_observations, const std::function<void()>& on_block) {
  RecordFile file(folder, "images", is_binary, kDigits,
                  "# Image list with two lines of data per image:\n"
                  "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                  "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
                  "# Number of images: ",
                  records.images.size(), on_block);
  file.Mean(", mean observations per image: ", num_observations, records.images.size());
  for (const ColmapIndex::Image& image : records.images) {
    file.BeginRecord();
    file.Integer(image.id);
    file.Pose(image.pose);
    file.Integer(image.camera_id);
    file.Name(image.name);
    file.BinaryCount(image.num_keypoints);
    file.EndLine();
    const uint64_t end = image.first_keypoint + image.num_keypoints;
    for (uint64_t k = image.first_keypoint; k < end; ++k) {
      file.MayFlush();
      file.Number(records.keypoint_xy[2 * k]);
      file.Number(records.keypoint_xy[2 * k + 1]);
      const uint64_t point = records.keypoint_points[k];
      if (point == kInvalidPoint3DId) {
        file.Named(point, "-1");
      } else {
        file.Integer(point);
      }
    }
    if (image.num_keypoints > 0) file.Blank();
  }
  file.Close();
}

/// v rotated by the quaternion qw qx qy qz, which is not normalized, and translated. The operations
/// and their order are those of COLMAP (Eigen).
std::array<double, 3> ToCamera(const std::array<double, 7>& pose, const double* v) {
  const double w = pose[0], x = pose[1], y = pose[2], z = pose[3];
  const double twice[3] = {2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]),
                           2 * (x * v[1] - y * v[0])};
  return {v[0] + w * twice[0] + (y * twice[2] - z * twice[1]) + pose[4],
          v[1] + w * twice[1] + (z * twice[0] - x * twice[2]) + pose[5],
          v[2] + w * twice[2] + (x * twice[1] - y * twice[0]) + pose[6]};
}

/// The cameras of images, by the position of the image.
std::vector<const ColmapIndex::Camera*> CamerasOfImages(const ColmapRecords& records) {
  std::vector<const ColmapIndex::Camera*> cameras;
  for (const ColmapIndex::Image& image : records.images) {
    cameras.push_back(&*std::lower_bound(
        records.cameras.begin(), records.cameras.end(), image.camera_id,
        [](const ColmapIndex::Camera& camera, uint32_t id) { return camera.id < id; }));
  }
  return cameras;
}

/// The angle between the rays of a point and of a pixel of a panorama, in pixels of the equator.
double ErrorOnSphere(const double* params, const std::array<double, 3>& p, const double* xy) {
  constexpr double kPi = 3.14159265358979323846;
  const double azimuth = 2 * kPi * (xy[0] / params[0] - 0.5);
  const double elevation = kPi * (xy[1] / params[1] - 0.5);
  const double ray[3] = {std::cos(elevation) * std::sin(azimuth), std::sin(elevation),
                         std::cos(elevation) * std::cos(azimuth)};
  const double across = std::hypot(ray[1] * p[2] - ray[2] * p[1], ray[2] * p[0] - ray[0] * p[2],
                                   ray[0] * p[1] - ray[1] * p[0]);
  const double along = ray[0] * p[0] + ray[1] * p[1] + ray[2] * p[2];
  return std::atan2(across, along) * params[0] / (2 * kPi);
}

double ErrorOf(const ColmapIndex::Image& image, const ColmapIndex::Camera& camera,
               const double* point, const double* measurement) {
  const std::array<double, 3> in_camera = ToCamera(image.pose, point);
  double xy[2];
  const Projection projection =
      camera.model->project(camera.params.data(), in_camera.data(), xy, nullptr, nullptr);
  if (projection != Projection::kValid) return std::sqrt(std::numeric_limits<double>::max());
  if (camera.model->name == std::string_view(Equirectangular::kName)) {
    return ErrorOnSphere(camera.params.data(), in_camera, measurement);
  }
  const double dx = xy[0] - measurement[0], dy = xy[1] - measurement[1];
  return std::sqrt(dx * dx + dy * dy);
}

void WritePoints(const ColmapRecords& records, bool is_binary, const std::filesystem::path& folder,
                 size_t num_observations, const std::function<void()>& on_block) {
  const std::vector<const ColmapIndex::Camera*> cameras = CamerasOfImages(records);
  RecordFile file(folder, "points3D", is_binary, kDigits,
                  "# 3D point list with one line of data per point:\n"
                  "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
                  "# Number of points: ",
                  records.num_points, on_block);
  file.Mean(", mean track length: ", num_observations, records.num_points);
  size_t begin = 0;
  for (size_t p = 0; p < records.num_points; ++p) {
    const double* point = records.points + 3 * p;
    const size_t end = begin + static_cast<size_t>(records.track_lengths[p]);
    double error = begin == end ? -1.0 : 0.0;
    for (size_t e = begin; e < end; ++e) {
      const auto i = static_cast<size_t>(records.track_images[e]);
      const ColmapIndex::Image& image = records.images[i];
      const uint64_t k = image.first_keypoint + static_cast<uint64_t>(records.track_keypoints[e]);
      error += ErrorOf(image, *cameras[i], point, records.keypoint_xy + 2 * k);
    }
    if (begin != end) error /= static_cast<double>(end - begin);

    file.BeginRecord();
    file.Integer(static_cast<uint64_t>(records.point_ids[p]));
    for (int i = 0; i < 3; ++i) file.Number(point[i]);
    for (int i = 0; i < 3; ++i) file.Integer(records.point_colors[3 * p + static_cast<size_t>(i)]);
    file.Number(is_binary || std::isfinite(error) ? error : -1.0);
    file.Blank();
    file.BinaryCount(static_cast<uint64_t>(end - begin));
    for (size_t e = begin; e < end; ++e) {
      file.Integer(records.images[static_cast<size_t>(records.track_images[e])].id);
      file.Integer(static_cast<uint32_t>(records.track_keypoints[e]));
    }
    begin = end;
  }
  file.Close();
}

}  // namespace

void WriteColmapRigs(const std::vector<ColmapIndex::Rig>& rigs, bool is_binary, int digits,
                     const std::filesystem::path& folder) {
  RecordFile file(folder, "rigs", is_binary, digits,
                  "# Rig calib list with one line of data per calib:\n"
                  "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
                  "(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n"
                  "# Number of rigs: ",
                  rigs.size());
  for (const ColmapIndex::Rig& rig : rigs) {
    file.BeginRecord();
    file.Integer(rig.id);
    file.Integer(static_cast<uint32_t>(rig.sensors.size()));
    for (size_t s = 0; s < rig.sensors.size(); ++s) {
      file.Sensor(rig.sensors[s]);
      if (s == 0) continue;
      file.Integer(static_cast<uint8_t>(rig.poses[s].is_known));
      if (rig.poses[s].is_known) file.Pose(rig.poses[s].pose);
    }
  }
  file.Close();
}

void WriteColmapFrames(const std::vector<ColmapIndex::Frame>& frames, bool is_binary, int digits,
                       const std::filesystem::path& folder) {
  RecordFile file(folder, "frames", is_binary, digits,
                  "# Frame list with one line of data per frame:\n"
                  "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], "
                  "NUM_DATA_IDS, DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n"
                  "# Number of frames: ",
                  frames.size());
  for (const ColmapIndex::Frame& frame : frames) {
    file.BeginRecord();
    file.Integer(frame.id);
    file.Integer(frame.rig_id);
    file.Pose(frame.pose);
    file.Integer(static_cast<uint32_t>(frame.data.size()));
    for (const ColmapIndex::Datum& datum : frame.data) {
      file.Sensor(datum.sensor);
      file.Integer(datum.id);
    }
  }
  file.Close();
}

void WriteColmapRecords(const ColmapRecords& records, bool is_binary,
                        const std::filesystem::path& folder,
                        const std::function<void()>& on_block) {
  size_t num_observations = 0;
  for (size_t p = 0; p < records.num_points; ++p) {
    num_observations += static_cast<size_t>(records.track_lengths[p]);
  }
  WriteColmapRigs(records.rigs, is_binary, kDigits, folder);
  WriteCameras(records, is_binary, folder);
  WriteColmapFrames(records.frames, is_binary, kDigits, folder);
  WriteImages(records, is_binary, folder, num_observations, on_block);
  WritePoints(records, is_binary, folder, num_observations, on_block);
}

}  // namespace bundle
