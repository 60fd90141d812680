#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/file_access.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "core/error.h"
#include "core/io/bal.h"
#include "core/io/bal_parts.h"
#include "core/io/bal_stream.h"
#include "core/io/input_file.h"

namespace py = pybind11;

namespace bundle {
namespace {

py::tuple ToTuple(BalProblem problem) {
  const auto num_images = static_cast<py::ssize_t>(problem.cam_from_world.size() / 7);
  const auto num_points = static_cast<py::ssize_t>(problem.points.size() / 3);
  const auto num_observations = static_cast<py::ssize_t>(problem.observation_image.size());
  return py::make_tuple(ToImmutableNumpy(std::move(problem.cam_from_world), {num_images, 7}),
                        ToImmutableNumpy(std::move(problem.rotations), {num_images, 3}),
                        ToImmutableNumpy(std::move(problem.camera_params), {num_images, 5}),
                        ToImmutableNumpy(std::move(problem.points), {num_points, 3}),
                        ToImmutableNumpy(std::move(problem.observation_image), {num_observations}),
                        ToImmutableNumpy(std::move(problem.observation_point), {num_observations}),
                        ToImmutableNumpy(std::move(problem.observation_xy), {num_observations, 2}));
}

py::tuple ReadBalFile(const py::object& path, const py::object& progress) {
  return ToTuple(ReadFile(path, ReadBal, progress));
}

py::tuple ReadPartOfBalFile(const py::object& path, const Array<int32_t>& place) {
  const LargeVector<int32_t> places(place.data(), place.data() + place.size());
  return ToTuple(ReadFile(path, [&](const auto& file, const auto& on_block) {
    return ReadBalPart(file, places, on_block);
  }));
}

py::tuple SurveyBalFile(const py::object& path) {
  BalSurvey survey = ReadFile(path, SurveyBal);
  const auto num_points = static_cast<py::ssize_t>(survey.num_seen.size());
  return py::make_tuple(survey.num_images, survey.num_observations,
                        ToImmutableNumpy(std::move(survey.first_image), {num_points}),
                        ToImmutableNumpy(std::move(survey.last_image), {num_points}),
                        ToImmutableNumpy(std::move(survey.num_seen), {num_points}));
}

template <typename T>
const T* Checked(const Array<T>& array, const char* name, int64_t rows, int64_t width) {
  const bool fits = width == 1
                        ? array.ndim() == 1 && array.shape(0) == rows
                        : array.ndim() == 2 && array.shape(0) == rows && array.shape(1) == width;
  if (!fits) {
    throw InputError(std::string(name) + ": expected " + std::to_string(rows) + " rows of " +
                     std::to_string(width) + " numbers");
  }
  return array.data();
}

/// All arrays except observations.
BalView ViewOf(const Array<double>& cam_from_world, const Array<double>& camera_params,
               const Array<double>& points, const Array<double>& rotations,
               const Array<bool>& keeps_rotation) {
  BalView problem;
  problem.num_images = cam_from_world.shape(0);
  problem.num_points = points.shape(0);
  problem.cam_from_world = Checked(cam_from_world, "cam_from_world", problem.num_images, 7);
  problem.camera_params = Checked(camera_params, "camera_params", problem.num_images, 5);
  problem.points = Checked(points, "points", problem.num_points, 3);
  problem.rotations = Checked(rotations, "rotations", problem.num_images, 3);
  problem.keeps_rotation = reinterpret_cast<const uint8_t*>(
      Checked(keeps_rotation, "keeps_rotation", problem.num_images, 1));
  return problem;
}

void WriteBalFileLike(const py::object& source, int64_t num_observations,
                      const py::object& given_path, const Array<double>& cam_from_world,
                      const Array<double>& camera_params, const Array<double>& points,
                      const Array<double>& rotations, const Array<bool>& keeps_rotation,
                      const std::string& compression) {
  const std::filesystem::path path = PathFromPython(given_path);
  BalView problem = ViewOf(cam_from_world, camera_params, points, rotations, keeps_rotation);
  problem.num_observations = num_observations;
  ReadFile(source, [&](const auto& file, const auto& on_block) {
    WriteBalLike(file, problem, path, CompressionFromName(compression), on_block);
    return true;
  });
}

/// Values, including indices, are those of a bundle.Problem, which has checked them.
void WriteBalFile(const py::object& given_path, const Array<double>& cam_from_world,
                  const Array<double>& camera_params, const Array<double>& points,
                  const Array<int32_t>& observation_image, const Array<int32_t>& observation_point,
                  const Array<double>& observation_xy, const Array<double>& rotations,
                  const Array<bool>& keeps_rotation, const std::string& compression,
                  const py::object& progress) {
  const std::filesystem::path path = PathFromPython(given_path);
  BalView problem = ViewOf(cam_from_world, camera_params, points, rotations, keeps_rotation);
  problem.num_observations = observation_xy.shape(0);
  problem.observation_image =
      Checked(observation_image, "observation_image", problem.num_observations, 1);
  problem.observation_point =
      Checked(observation_point, "observation_point", problem.num_observations, 1);
  problem.observation_xy = Checked(observation_xy, "observation_xy", problem.num_observations, 2);
  BlockWatch watch(progress, OutputFile::kBlockSize);
  try {
    const ReleaseGil release;
    WriteBal(problem, path, CompressionFromName(compression), watch.OnBlock());
  } catch (const std::system_error& error) {
    ThrowOsError(error, path);
  }
}

/// Runs `call()` without the GIL; system errors name the file.
template <typename Call>
void Unlocked(const BalStream& stream, const Call& call) {
  try {
    const ReleaseGil release;
    call();
  } catch (const std::system_error& error) {
    ThrowOsError(error, stream.path());
  }
}

std::unique_ptr<BalStream> OpenBalStream(const py::list& given, int64_t num_images,
                                         int64_t num_points) {
  std::vector<std::filesystem::path> paths;
  for (const py::handle path : given) {
    paths.push_back(PathFromPython(py::reinterpret_borrow<py::object>(path)));
  }
  std::unique_ptr<BalStream> stream;
  try {
    stream = std::make_unique<BalStream>(paths, num_images, num_points, CheckSignals);
  } catch (const std::system_error& error) {
    ThrowOsError(error, paths.front());
  }
  return stream;
}

/// Indices are made by bundle.synthetic.
void StreamObservations(BalStream& stream, const Array<double>& camera_params,
                        const Array<int32_t>& image, const Array<int32_t>& point,
                        const Array<double>& xy) {
  BalView view;
  view.num_observations = xy.shape(0);
  view.camera_params = Checked(camera_params, "camera_params", camera_params.shape(0), 5);
  view.observation_image = Checked(image, "observation_image", view.num_observations, 1);
  view.observation_point = Checked(point, "observation_point", view.num_observations, 1);
  view.observation_xy = Checked(xy, "observation_xy", view.num_observations, 2);
  Unlocked(stream, [&] { stream.AddObservations(view); });
}

void StreamCameras(BalStream& stream, int file, const Array<double>& cam_from_world,
                   const Array<double>& camera_params) {
  BalView view;
  view.num_images = cam_from_world.shape(0);
  view.cam_from_world = Checked(cam_from_world, "cam_from_world", view.num_images, 7);
  view.camera_params = Checked(camera_params, "camera_params", view.num_images, 5);
  Unlocked(stream, [&] { stream.AddCameras(file, view); });
}

void StreamPoints(BalStream& stream, int file, const Array<double>& points) {
  BalView view;
  view.num_points = points.shape(0);
  view.points = Checked(points, "points", view.num_points, 3);
  Unlocked(stream, [&] { stream.AddPoints(file, view); });
}

}  // namespace
}  // namespace bundle

void BindBal(py::module_& m) {
  m.def("read_bal", &bundle::ReadBalFile, py::arg("path"), py::arg("progress") = py::none());
  m.def("survey_bal", &bundle::SurveyBalFile, py::arg("path"));
  m.def("read_bal_part", &bundle::ReadPartOfBalFile, py::arg("path"), py::arg("place"));
  py::class_<bundle::BalStream>(m, "BalStream")
      .def(py::init(&bundle::OpenBalStream), py::arg("paths"), py::arg("num_images"),
           py::arg("num_points"))
      .def("add_observations", &bundle::StreamObservations, py::arg("camera_params"),
           py::arg("observation_image"), py::arg("observation_point"), py::arg("observation_xy"))
      .def("add_cameras", &bundle::StreamCameras, py::arg("file"), py::arg("cam_from_world"),
           py::arg("camera_params"))
      .def("add_points", &bundle::StreamPoints, py::arg("file"), py::arg("points"))
      .def("close",
           [](bundle::BalStream& stream) { bundle::Unlocked(stream, [&] { stream.Close(); }); });
  m.def("write_bal_like", &bundle::WriteBalFileLike, py::arg("source"), py::arg("num_observations"),
        py::arg("path"), py::arg("cam_from_world"), py::arg("camera_params"), py::arg("points"),
        py::arg("rotations"), py::arg("keeps_rotation"), py::arg("compression"));
  m.def("write_bal", &bundle::WriteBalFile, py::arg("path"), py::arg("cam_from_world"),
        py::arg("camera_params"), py::arg("points"), py::arg("observation_image"),
        py::arg("observation_point"), py::arg("observation_xy"), py::arg("rotations"),
        py::arg("keeps_rotation"), py::arg("compression"), py::arg("progress") = py::none());
}
