#include "bindings/problem_from_python.h"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <limits>
#include <string>
#include <vector>

#include "core/cameras/registry.h"
#include "core/error.h"

namespace py = pybind11;

namespace {

std::string ShapeText(const std::vector<py::ssize_t>& shape) {
  std::string text = "(";
  for (size_t i = 0; i < shape.size(); ++i) {
    if (i > 0) text += ", ";
    text += shape[i] < 0 ? "N" : std::to_string(shape[i]);
  }
  return text + (shape.size() == 1 ? ",)" : ")");
}

/// The data of the array attribute `name`, whose shape must be `shape` (-1: any).
template <typename T>
const T* Data(const py::handle& problem, const char* name, const std::vector<py::ssize_t>& shape) {
  const auto array = py::cast<py::array>(problem.attr(name));
  std::vector<py::ssize_t> found(array.shape(), array.shape() + array.ndim());
  bool fits = found.size() == shape.size();
  for (size_t i = 0; fits && i < shape.size(); ++i) fits = shape[i] < 0 || found[i] == shape[i];
  if (!fits) {
    throw bundle::InputError(std::string(name) + ": expected shape " + ShapeText(shape) +
                             ", found " + ShapeText(found));
  }
  if (!py::isinstance<py::array_t<T, py::array::c_style>>(array)) {
    throw bundle::InputError(std::string(name) + ": expected a C-contiguous array of " +
                             std::string(py::str(py::dtype::of<T>())) + ", found " +
                             std::string(py::str(array.dtype())));
  }
  return static_cast<const T*>(array.data());
}

int Count(const py::handle& problem, const char* name) {
  const auto size = static_cast<size_t>(py::len(problem.attr(name)));
  if (size > static_cast<size_t>(std::numeric_limits<int>::max())) {
    throw bundle::InputError(std::string(name) + ": expected at most 2147483647 entries, found " +
                             std::to_string(size));
  }
  return static_cast<int>(size);
}

/// Rigs of several sensors; a problem without `rig_from_world` has none.
void ViewRigs(const py::handle& problem, bundle::ProblemView* view) {
  if (!py::hasattr(problem, "rig_from_world")) return;
  view->num_frames = Count(problem, "rig_from_world");
  view->num_sensors = Count(problem, "sensor_from_rig");
  view->rig_from_world = Data<double>(problem, "rig_from_world", {-1, 7});
  view->sensor_from_rig = Data<double>(problem, "sensor_from_rig", {-1, 7});
  // Without rigs, these arrays are not read and may be empty.
  if (view->num_frames > 0 || view->num_sensors > 0) {
    view->image_frame = Data<int32_t>(problem, "image_frame", {view->num_images});
    view->image_sensor = Data<int32_t>(problem, "image_sensor", {view->num_images});
  }
  view->frame_ids = Data<int64_t>(problem, "frame_ids", {view->num_frames});
  view->frame_rig_ids = Data<int64_t>(problem, "frame_rig_ids", {view->num_frames});
  view->sensor_rig_ids = Data<int64_t>(problem, "sensor_rig_ids", {view->num_sensors});
  view->sensor_camera_ids = Data<int64_t>(problem, "sensor_camera_ids", {view->num_sensors});
}

/// Python has checked that images of rolling shutters have a size and a pose of their own.
void ViewRollingShutter(const py::handle& problem, bundle::ProblemView* view) {
  if (!py::hasattr(problem, "rolling_shutter")) return;
  const py::object shutter = problem.attr("rolling_shutter");
  if (shutter.is_none()) return;
  const auto* const axis = Data<int8_t>(shutter, "axis", {view->num_cameras});
  const auto* const sizes = Data<int64_t>(problem, "camera_sizes", {view->num_cameras, 2});
  view->row_scale.assign(2 * static_cast<size_t>(view->num_cameras), 0.0);
  for (int c = 0; c < view->num_cameras; ++c) {
    const int64_t length = axis[c] == 2 ? sizes[2 * c] : sizes[2 * c + 1];
    if (axis[c] == 0 || length <= 0) continue;
    view->row_scale[2 * c + (axis[c] == 2 ? 0 : 1)] = 1 / static_cast<double>(length);
  }
  view->twists = Data<double>(shutter, "twist", {view->num_images, 6});
  view->readouts = Data<double>(shutter, "readout", {view->num_cameras});
  view->at_observed_row = py::cast<std::string>(shutter.attr("row_time")) == "observed";
  if (!shutter.attr("neighbours").is_none()) {
    view->twist_neighbours = Data<int32_t>(shutter, "neighbours", {view->num_images, 2});
  }
  if (!shutter.attr("frames").is_none()) {
    view->image_frames = Data<double>(shutter, "frames", {view->num_images});
  }
}

}  // namespace

bundle::ProblemView ViewProblem(const py::handle& problem) {
  bundle::ProblemView view;
  view.num_images = Count(problem, "cam_from_world");
  view.num_cameras = Count(problem, "camera_params");
  view.num_points = Count(problem, "points");
  view.num_observations = Count(problem, "observation_xy");

  view.cam_from_world = Data<double>(problem, "cam_from_world", {-1, 7});
  view.image_ids = Data<int64_t>(problem, "image_ids", {view.num_images});
  view.image_camera = Data<int32_t>(problem, "image_camera", {view.num_images});
  ViewRigs(problem, &view);
  view.camera_ids = Data<int64_t>(problem, "camera_ids", {view.num_cameras});
  view.camera_params = Data<double>(problem, "camera_params", {-1, -1});
  view.camera_params_stride =
      static_cast<int>(py::cast<py::array>(problem.attr("camera_params")).shape(1));
  Data<int64_t>(problem, "camera_sizes", {view.num_cameras, 2});
  ViewRollingShutter(problem, &view);
  view.points = Data<double>(problem, "points", {-1, 3});
  view.point_ids = Data<int64_t>(problem, "point_ids", {view.num_points});
  view.observation_image = Data<int32_t>(problem, "observation_image", {view.num_observations});
  view.observation_point = Data<int32_t>(problem, "observation_point", {view.num_observations});
  view.observation_xy = Data<double>(problem, "observation_xy", {-1, 2});
  if (!problem.attr("observation_sigma").is_none()) {
    view.observation_sigma = Data<double>(problem, "observation_sigma", {view.num_observations});
  }
  if (!problem.attr("observation_keypoint").is_none()) {
    Data<int32_t>(problem, "observation_keypoint", {view.num_observations});
  }

  if (Count(problem, "image_names") != view.num_images) {
    throw bundle::InputError("image_names: expected " + std::to_string(view.num_images) +
                             " names, found " + std::to_string(Count(problem, "image_names")));
  }
  view.camera_model_names = py::cast<std::vector<std::string>>(problem.attr("camera_models"));
  if (view.camera_model_names.size() != static_cast<size_t>(view.num_cameras)) {
    throw bundle::InputError("camera_models: expected " + std::to_string(view.num_cameras) +
                             " names, found " + std::to_string(view.camera_model_names.size()));
  }
  for (const std::string& name : view.camera_model_names) {
    view.camera_models.push_back(bundle::FindCameraModel(name));
  }
  return view;
}

bundle::Restrictions ViewRestrictions(const py::object& restrictions,
                                      const bundle::ProblemView& problem) {
  bundle::Restrictions view;
  if (restrictions.is_none()) return view;
  const py::ssize_t num_cameras = problem.num_cameras, stride = problem.camera_params_stride;
  const py::ssize_t num_images = problem.num_images;
  const auto has = [&](const char* name) { return !restrictions.attr(name).is_none(); };
  if (has("lower")) {
    view.camera_lower = Data<double>(restrictions, "lower", {num_cameras, stride});
    view.camera_upper = Data<double>(restrictions, "upper", {num_cameras, stride});
  }
  if (has("held_camera_params")) {
    view.held_camera_params = Data<uint32_t>(restrictions, "held_camera_params", {num_cameras});
  }
  if (has("held_pose_parts")) {
    view.held_pose_parts = Data<uint8_t>(restrictions, "held_pose_parts", {num_images});
  }
  if (has("camera_tie")) {
    view.camera_tie = Data<int32_t>(restrictions, "camera_tie", {num_cameras, stride});
    view.camera_tie_scale = Data<double>(restrictions, "camera_tie_scale", {num_cameras, stride});
    view.num_ties = py::cast<int>(restrictions.attr("num_ties"));
  }
  return view;
}
