#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/file_access.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "core/error.h"
#include "core/io/colmap_model.h"
#include "core/io/colmap_parts.h"
#include "core/io/colmap_rigs.h"
#include "core/io/colmap_survey.h"
#include "core/io/colmap_writer.h"

namespace py = pybind11;

namespace bundle {
namespace {

/// One number per record, in the order of the ids.
template <typename T, typename Record, typename Get>
py::array ColumnOf(const std::vector<Record>& records, const std::vector<size_t>& by_id, Get get) {
  std::vector<T> column(records.size());
  std::transform(by_id.begin(), by_id.end(), column.begin(),
                 [&](size_t position) { return static_cast<T>(get(records[position])); });
  const auto size = static_cast<py::ssize_t>(column.size());
  return ToImmutableNumpy(std::move(column), {size});
}

template <typename Record>
py::array Ids(const std::vector<Record>& records, const std::vector<size_t>& by_id) {
  return ColumnOf<int64_t>(records, by_id, [](const Record& record) { return record.id; });
}

void PutCameras(const ColmapModel& model, py::dict* fields) {
  const std::vector<ColmapIndex::Camera>& cameras = model.index.cameras;
  const std::vector<size_t>& order = model.cameras_by_id;
  size_t width = 0;
  for (const auto& camera : cameras) {
    width = std::max(width, static_cast<size_t>(camera.model->num_params));
  }
  std::vector<double> params(order.size() * width, 0.0);
  std::vector<int64_t> sizes;
  py::tuple models(order.size());
  for (size_t row = 0; row < order.size(); ++row) {
    const ColmapIndex::Camera& camera = cameras[order[row]];
    std::copy_n(camera.params.begin(), camera.model->num_params,
                params.begin() + static_cast<std::ptrdiff_t>(row * width));
    sizes.insert(sizes.end(),
                 {static_cast<int64_t>(camera.width), static_cast<int64_t>(camera.height)});
    models[row] = py::str(camera.model->name);
  }
  const auto rows = static_cast<py::ssize_t>(order.size());
  (*fields)["camera_ids"] = Ids(cameras, order);
  (*fields)["camera_models"] = models;
  (*fields)["camera_params"] =
      ToImmutableNumpy(std::move(params), {rows, static_cast<py::ssize_t>(width)});
  (*fields)["camera_sizes"] = ToImmutableNumpy(std::move(sizes), {rows, 2});
}

void PutImages(const ColmapModel& model, py::dict* fields) {
  const std::vector<ColmapIndex::Image>& images = model.index.images;
  const std::vector<size_t>& order = model.images_by_id;
  std::vector<uint32_t> camera_ids;
  for (const size_t c : model.cameras_by_id) camera_ids.push_back(model.index.cameras[c].id);
  const auto camera_row = [&](const ColmapIndex::Image& image) {
    return std::lower_bound(camera_ids.begin(), camera_ids.end(), image.camera_id) -
           camera_ids.begin();
  };
  py::tuple names(order.size());
  for (size_t row = 0; row < order.size(); ++row) names[row] = py::str(images[order[row]].name);
  const auto rows = static_cast<py::ssize_t>(order.size());
  (*fields)["cam_from_world"] = ToImmutableNumpy(model.CamFromWorld(), {rows, 7});
  (*fields)["image_ids"] = Ids(images, order);
  (*fields)["image_names"] = names;
  (*fields)["image_camera"] = ColumnOf<int32_t>(images, order, camera_row);
}

void PutRigs(const ColmapModel& model, py::dict* fields) {
  const ColmapRigs& rigs = model.rigs;
  const auto num_frames = static_cast<py::ssize_t>(rigs.frames.size());
  const auto num_sensors = static_cast<py::ssize_t>(rigs.sensors.size());
  std::vector<int64_t> frame_ids, frame_rig_ids, sensor_rig_ids, sensor_camera_ids;
  for (const size_t f : rigs.frames) {
    frame_ids.push_back(model.index.frames[f].id);
    frame_rig_ids.push_back(model.index.frames[f].rig_id);
  }
  for (const auto& [r, s] : rigs.sensors) {
    sensor_rig_ids.push_back(model.index.rigs[r].id);
    sensor_camera_ids.push_back(model.index.rigs[r].sensors[s].id);
  }
  const auto num_images = static_cast<py::ssize_t>(rigs.image_frame.size());
  (*fields)["rig_from_world"] = ToImmutableNumpy(model.RigFromWorld(), {num_frames, 7});
  (*fields)["frame_ids"] = ToImmutableNumpy(std::move(frame_ids), {num_frames});
  (*fields)["frame_rig_ids"] = ToImmutableNumpy(std::move(frame_rig_ids), {num_frames});
  (*fields)["image_frame"] = ToImmutableNumpy(std::vector<int32_t>(rigs.image_frame), {num_images});
  (*fields)["image_sensor"] =
      ToImmutableNumpy(std::vector<int32_t>(rigs.image_sensor), {num_images});
  (*fields)["sensor_from_rig"] = ToImmutableNumpy(model.SensorFromRig(), {num_sensors, 7});
  (*fields)["sensor_rig_ids"] = ToImmutableNumpy(std::move(sensor_rig_ids), {num_sensors});
  (*fields)["sensor_camera_ids"] = ToImmutableNumpy(std::move(sensor_camera_ids), {num_sensors});
}

void PutPoints(ColmapModel* model, py::dict* fields) {
  const auto rows = static_cast<py::ssize_t>(model->point_ids.size());
  (*fields)["points"] = ToImmutableNumpy(std::move(model->points), {rows, 3});
  (*fields)["point_ids"] = ToImmutableNumpy(std::move(model->point_ids), {rows});
}

void PutObservations(ColmapObservations observations, py::dict* fields) {
  const auto size = static_cast<py::ssize_t>(observations.image.size());
  (*fields)["observation_image"] = ToImmutableNumpy(std::move(observations.image), {size});
  (*fields)["observation_point"] = ToImmutableNumpy(std::move(observations.point), {size});
  (*fields)["observation_keypoint"] = ToImmutableNumpy(std::move(observations.keypoint), {size});
  (*fields)["observation_xy"] = ToImmutableNumpy(std::move(observations.xy), {size, 2});
}

/// The model, and the fields of a bundle.Problem by name.
py::tuple ReadModel(const std::string& folder, bool may_be_empty) {
  auto model = std::make_unique<ColmapModel>();
  {
    const ReleaseGil release;
    *model = ReadColmapModel(folder, may_be_empty);
  }
  py::dict fields;
  PutCameras(*model, &fields);
  PutImages(*model, &fields);
  PutRigs(*model, &fields);
  PutPoints(model.get(), &fields);
  PutObservations(std::move(model->observations), &fields);
  return py::make_tuple(std::move(model), fields);
}

void ExpectShape(const Array<double>& array, const char* name, size_t rows, py::ssize_t width) {
  const bool fits = array.ndim() == 2 && array.shape(0) == static_cast<py::ssize_t>(rows) &&
                    (width < 0 || array.shape(1) == width);
  if (!fits) {
    throw InputError(std::string(name) + ": expected " + std::to_string(rows) + " rows of " +
                     std::to_string(width) + " numbers");
  }
}

/// The values from these arrays, which must have the shapes of the model.
ColmapValues CheckedValues(const ColmapModel& model, const Array<int64_t>& point_ids,
                           const Array<double>& cam_from_world, const Array<double>& camera_params,
                           const Array<double>& points, const Array<double>& point_errors,
                           const Array<double>& rig_from_world,
                           const Array<double>& sensor_from_rig) {
  const auto num_points = static_cast<size_t>(point_ids.size());
  ExpectShape(cam_from_world, "cam_from_world", model.images_by_id.size(), 7);
  ExpectShape(rig_from_world, "rig_from_world", model.rigs.frames.size(), 7);
  ExpectShape(sensor_from_rig, "sensor_from_rig", model.rigs.sensors.size(), 7);
  ExpectShape(camera_params, "camera_params", model.cameras_by_id.size(), -1);
  ExpectShape(points, "points", num_points, 3);
  ExpectShape(point_errors, "point_errors", num_points, 1);
  for (const auto& camera : model.index.cameras) {
    if (camera.model->num_params > camera_params.shape(1)) {
      throw InputError("camera_params: expected at least " +
                       std::to_string(camera.model->num_params) + " columns, found " +
                       std::to_string(camera_params.shape(1)));
    }
  }
  return {cam_from_world.data(),
          rig_from_world.data(),
          sensor_from_rig.data(),
          camera_params.data(),
          static_cast<size_t>(camera_params.shape(1)),
          num_points,
          point_ids.data(),
          points.data(),
          point_errors.data()};
}

void WriteModel(const ColmapModel& model, const py::object& given_folder,
                const Array<double>& cam_from_world, const Array<double>& camera_params,
                const Array<double>& points, const Array<double>& point_errors,
                const Array<double>& rig_from_world, const Array<double>& sensor_from_rig,
                const Array<int64_t>& point_ids) {
  const std::filesystem::path folder = PathFromPython(given_folder);
  const ColmapValues values = CheckedValues(model, point_ids, cam_from_world, camera_params, points,
                                            point_errors, rig_from_world, sensor_from_rig);
  try {
    const ReleaseGil release;
    WriteColmapModel(model, values, folder);
  } catch (const std::system_error& error) {
    ThrowOsError(error, folder);
  }
}

py::tuple SurveyModel(const std::string& folder) {
  ColmapSurvey survey;
  {
    const ReleaseGil release;
    survey = SurveyColmap(folder, CheckSignals);
  }
  const auto num_points = static_cast<py::ssize_t>(survey.point_ids.size());
  return py::make_tuple(survey.num_images, survey.num_observations,
                        ToImmutableNumpy(std::move(survey.point_ids), {num_points}),
                        ToImmutableNumpy(std::move(survey.first_image), {num_points}),
                        ToImmutableNumpy(std::move(survey.last_image), {num_points}),
                        ToImmutableNumpy(std::move(survey.num_seen), {num_points}));
}

/// The model, the fields of a bundle.Problem by name except the ids of the points, and
/// contradictions: file (0: points), position in it, message.
py::tuple ReadPartOfModel(const std::string& folder, const Array<int64_t>& point_ids,
                          const Array<int32_t>& place) {
  if (point_ids.size() != place.size()) {
    throw InputError("place: expected " + std::to_string(point_ids.size()) + " numbers");
  }
  const LargeVector<int64_t> ids(point_ids.data(), point_ids.data() + point_ids.size());
  const LargeVector<int32_t> places(place.data(), place.data() + place.size());
  ColmapPart part;
  {
    const ReleaseGil release;
    part = ReadColmapPart(folder, ids, places, CheckSignals);
  }
  py::dict fields;
  PutCameras(part.model, &fields);
  PutImages(part.model, &fields);
  PutRigs(part.model, &fields);
  const auto num_points = static_cast<py::ssize_t>(part.points.size() / 3);
  fields["points"] = ToImmutableNumpy(std::move(part.points), {num_points, 3});
  PutObservations(std::move(part.observations), &fields);
  py::object failure = py::none();
  if (part.failure.has_value()) {
    failure = py::make_tuple(part.failure->is_in_images ? 1 : 0, part.failure->position,
                             part.failure->message);
  }
  return py::make_tuple(std::make_unique<ColmapModel>(std::move(part.model)), fields, failure);
}

/// The files by name, with the contents that were read.
py::dict Files(const ColmapModel& model) {
  const ColmapIndex& index = model.index;
  py::dict files;
  for (const ModelFile* file : {&index.rigs_file, &index.cameras_file, &index.frames_file,
                                &index.images_file, &index.points_file}) {
    if (file->path().empty()) continue;
    const py::bytes contents(nullptr, file->size());
    file->ReadAt(0, PyBytes_AS_STRING(contents.ptr()), file->size());
    files[py::str(std::filesystem::path(file->path()).filename().string())] = contents;
  }
  return files;
}

/// Names of text files that contain white space, by image id. COLMAP writes them but reads only
/// their first word back.
std::map<uint32_t, std::string> NamesWithSpaces(const ColmapModel& model) {
  std::map<uint32_t, std::string> names;
  if (model.is_binary()) return names;
  for (const ColmapIndex::Image& image : model.index.images) {
    if (image.name.find(' ') != std::string::npos) names.emplace(image.id, image.name);
  }
  return names;
}

py::object ImagePoses(const ColmapModel& model) {
  const auto rows = static_cast<py::ssize_t>(model.index.images.size());
  return ToImmutableNumpy(model.ImagePoses(), {rows, 7});
}

}  // namespace
}  // namespace bundle

void BindColmap(py::module_& m) {
  using bundle::ColmapModel;
  m.def("read_colmap_model", &bundle::ReadModel, py::arg("folder"),
        py::arg("may_be_empty") = false);
  py::class_<ColmapModel>(m, "ColmapModel")
      .def_property_readonly("is_binary", &ColmapModel::is_binary)
      .def_property_readonly("has_changed", &ColmapModel::has_changed)
      .def_property_readonly("names_with_spaces", &bundle::NamesWithSpaces)
      .def_property_readonly("image_poses", &bundle::ImagePoses)
      .def("files", &bundle::Files)
      .def("write", &bundle::WriteModel, py::arg("folder"), py::arg("cam_from_world"),
           py::arg("camera_params"), py::arg("points"), py::arg("point_errors"),
           py::arg("rig_from_world"), py::arg("sensor_from_rig"), py::arg("point_ids"));
  m.def("survey_colmap_model", &bundle::SurveyModel, py::arg("folder"));
  m.def("read_colmap_part", &bundle::ReadPartOfModel, py::arg("folder"), py::arg("point_ids"),
        py::arg("place"));
}
