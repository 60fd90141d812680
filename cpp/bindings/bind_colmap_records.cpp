#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/file_access.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "core/cameras/registry.h"
#include "core/error.h"
#include "core/io/colmap_contents.h"
#include "core/io/colmap_records.h"

namespace py = pybind11;

namespace bundle {
namespace {

/// qx qy qz qw tx ty tz, as in all Python arrays.
using Pose = std::array<double, 7>;

// Type and id; the pose on the rig, None if it is unknown.
using SensorTuple = std::tuple<int32_t, uint32_t, std::optional<Pose>>;
using RigTuple = std::tuple<uint32_t, std::vector<SensorTuple>>;
// Type and id of the sensor, and id of its data.
using DatumTuple = std::tuple<int32_t, uint32_t, uint64_t>;
using FrameTuple = std::tuple<uint32_t, uint32_t, Pose, std::vector<DatumTuple>>;

Pose FromFile(const std::array<double, 7>& pose) {
  return {pose[1], pose[2], pose[3], pose[0], pose[4], pose[5], pose[6]};
}

std::array<double, 7> ToFile(const double* pose) {
  return {pose[3], pose[0], pose[1], pose[2], pose[4], pose[5], pose[6]};
}

/// Rigs and frames of a model, and ids, cameras and numbers of keypoints of its images, in the
/// order of its files.
py::dict Views(const ColmapModel& model) {
  std::vector<RigTuple> rigs;
  for (const ColmapIndex::Rig& rig : model.index.rigs) {
    std::vector<SensorTuple> sensors;
    for (size_t s = 0; s < rig.sensors.size(); ++s) {
      std::optional<Pose> pose;
      if (rig.poses[s].is_known) pose = FromFile(rig.poses[s].pose);
      sensors.emplace_back(static_cast<int32_t>(rig.sensors[s].type), rig.sensors[s].id, pose);
    }
    rigs.emplace_back(rig.id, std::move(sensors));
  }
  std::vector<FrameTuple> frames;
  for (const ColmapIndex::Frame& frame : model.index.frames) {
    std::vector<DatumTuple> data;
    for (const ColmapIndex::Datum& datum : frame.data) {
      data.emplace_back(static_cast<int32_t>(datum.sensor.type), datum.sensor.id, datum.id);
    }
    frames.emplace_back(frame.id, frame.rig_id, FromFile(frame.pose), std::move(data));
  }
  std::vector<int64_t> image_ids, image_camera_ids, num_keypoints;
  for (const ColmapIndex::Image& image : model.index.images) {
    image_ids.push_back(image.id);
    image_camera_ids.push_back(image.camera_id);
    num_keypoints.push_back(static_cast<int64_t>(image.num_keypoints));
  }
  std::vector<uint32_t> camera_ids;
  for (const ColmapIndex::Camera& camera : model.index.cameras) camera_ids.push_back(camera.id);
  const auto num_images = static_cast<py::ssize_t>(image_ids.size());
  py::dict views;
  views["camera_ids"] = camera_ids;
  views["rigs"] = rigs;
  views["frames"] = frames;
  views["image_ids"] = ToImmutableNumpy(std::move(image_ids), {num_images});
  views["image_camera_ids"] = ToImmutableNumpy(std::move(image_camera_ids), {num_images});
  views["num_keypoints"] = ToImmutableNumpy(std::move(num_keypoints), {num_images});
  return views;
}

/// Keypoints, ids and colours of points, and tracks, in the order of the files.
py::dict Contents(const ColmapModel& model) {
  std::vector<double> xy;
  ColmapTracks tracks;
  {
    const ReleaseGil release;
    xy = ReadKeypoints(model);
    tracks = ReadTracks(model);
  }
  std::vector<int64_t> images, keypoints;
  for (const ColmapIndex::TrackElement& element : tracks.elements) {
    images.push_back(element.image_id);
    keypoints.push_back(element.keypoint);
  }
  const auto num_points = static_cast<py::ssize_t>(tracks.point_ids.size());
  const auto num_keypoints = static_cast<py::ssize_t>(xy.size() / 2);
  const auto num_elements = static_cast<py::ssize_t>(images.size());
  py::dict contents;
  contents["keypoint_xy"] = ToImmutableNumpy(std::move(xy), {num_keypoints, 2});
  contents["point_ids"] = ToImmutableNumpy(std::move(tracks.point_ids), {num_points});
  contents["point_colors"] = ToImmutableNumpy(std::move(tracks.colors), {num_points, 3});
  contents["track_lengths"] = ToImmutableNumpy(std::move(tracks.lengths), {num_points});
  contents["track_image_ids"] = ToImmutableNumpy(std::move(images), {num_elements});
  contents["track_keypoints"] = ToImmutableNumpy(std::move(keypoints), {num_elements});
  return contents;
}

/// An attribute of a Python object, as an array of `rows` rows.
template <typename T>
CastArray<T> ArrayOf(const py::object& owner, const char* name, size_t rows, size_t width = 1) {
  auto array = owner.attr(name).cast<CastArray<T>>();
  if (static_cast<size_t>(array.size()) != rows * width) {
    throw InputError(std::string(name) + ": expected " + std::to_string(rows) + " rows of " +
                     std::to_string(width) + ", found " + std::to_string(array.size()) +
                     " numbers");
  }
  return array;
}

size_t Length(const py::object& owner, const char* name) { return py::len(owner.attr(name)); }

void TakeCameras(const py::object& given, ColmapRecords* records) {
  const size_t count = Length(given, "camera_ids");
  const auto ids = ArrayOf<uint32_t>(given, "camera_ids", count);
  const auto sizes = ArrayOf<uint64_t>(given, "camera_sizes", count, 2);
  const auto params = given.attr("camera_params").cast<CastArray<double>>();
  const py::sequence models = given.attr("camera_models");
  for (size_t c = 0; c < count; ++c) {
    const CameraModel* model = FindCameraModel(models[c].cast<std::string>());
    ColmapIndex::Camera camera{ids.data()[c],           0,  model, sizes.data()[2 * c],
                               sizes.data()[2 * c + 1], {}, {}};
    std::copy_n(params.data(static_cast<py::ssize_t>(c)), model->num_params, camera.params.begin());
    records->cameras.push_back(camera);
  }
}

void TakeRigs(const py::object& given, ColmapRecords* records) {
  for (const auto& [id, sensors] : given.attr("rigs").cast<std::vector<RigTuple>>()) {
    ColmapIndex::Rig& rig = records->rigs.emplace_back(ColmapIndex::Rig{id, 0});
    for (const auto& [type, sensor_id, pose] : sensors) {
      rig.sensors.push_back({static_cast<SensorType>(type), sensor_id});
      rig.poses.emplace_back();
      if (pose) rig.poses.back() = {true, ToFile(pose->data())};
    }
  }
  for (const auto& [id, rig_id, pose, data] :
       given.attr("frames").cast<std::vector<FrameTuple>>()) {
    ColmapIndex::Frame& frame =
        records->frames.emplace_back(ColmapIndex::Frame{id, rig_id, 0, {}, ToFile(pose.data())});
    for (const auto& [type, sensor_id, datum_id] : data) {
      frame.data.push_back({{static_cast<SensorType>(type), sensor_id}, datum_id});
    }
  }
}

/// Returns the number of keypoints.
uint64_t TakeImages(const py::object& given, ColmapRecords* records) {
  const size_t count = Length(given, "image_ids");
  const auto ids = ArrayOf<uint32_t>(given, "image_ids", count);
  const auto cameras = ArrayOf<uint32_t>(given, "image_camera_ids", count);
  const auto num_keypoints = ArrayOf<uint64_t>(given, "num_keypoints", count);
  const auto poses = ArrayOf<double>(given, "cam_from_world", count, 7);
  const py::sequence names = given.attr("image_names");
  uint64_t first = 0;
  for (size_t i = 0; i < count; ++i) {
    records->images.push_back({ids.data()[i],
                               cameras.data()[i],
                               0,
                               0,
                               first,
                               num_keypoints.data()[i],
                               names[i].cast<std::string>(),
                               ToFile(poses.data() + 7 * i),
                               {}});
    first += num_keypoints.data()[i];
  }
  return first;
}

/// Writes the model from the attributes of `given`, which are those of ColmapRecords.
void WriteRecords(const py::object& given_folder, bool is_binary, const py::object& given) {
  const std::filesystem::path folder = PathFromPython(given_folder);
  ColmapRecords records;
  TakeCameras(given, &records);
  TakeRigs(given, &records);
  const uint64_t num_keypoints = TakeImages(given, &records);
  const auto xy = ArrayOf<double>(given, "keypoint_xy", num_keypoints, 2);
  const auto keypoint_points = ArrayOf<uint64_t>(given, "keypoint_points", num_keypoints);
  records.num_points = Length(given, "point_ids");
  const auto point_ids = ArrayOf<int64_t>(given, "point_ids", records.num_points);
  const auto points = ArrayOf<double>(given, "points", records.num_points, 3);
  const auto colors = ArrayOf<uint8_t>(given, "point_colors", records.num_points, 3);
  const auto lengths = ArrayOf<int64_t>(given, "track_lengths", records.num_points);
  const size_t num_elements = Length(given, "track_images");
  const auto track_images = ArrayOf<int32_t>(given, "track_images", num_elements);
  const auto track_keypoints = ArrayOf<int32_t>(given, "track_keypoints", num_elements);
  records.keypoint_xy = xy.data();
  records.keypoint_points = keypoint_points.data();
  records.point_ids = point_ids.data();
  records.points = points.data();
  records.point_colors = colors.data();
  records.track_lengths = lengths.data();
  records.track_images = track_images.data();
  records.track_keypoints = track_keypoints.data();
  try {
    const ReleaseGil release;
    WriteColmapRecords(records, is_binary, folder, CheckSignals);
  } catch (const std::system_error& error) {
    ThrowOsError(error, folder);
  }
}

}  // namespace
}  // namespace bundle

void BindColmapRecords(py::module_& m) {
  m.def("colmap_views", &bundle::Views, py::arg("model"));
  m.def("colmap_contents", &bundle::Contents, py::arg("model"));
  m.def("write_colmap_records", &bundle::WriteRecords, py::arg("folder"), py::arg("is_binary"),
        py::arg("records"));
}
