#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "core/cameras/registry.h"
#include "core/error.h"

namespace py = pybind11;

namespace {

const char* KindName(bundle::CameraParam::Kind kind) {
  switch (kind) {
    case bundle::CameraParam::kFocal:
      return "focal";
    case bundle::CameraParam::kPrincipalPoint:
      return "principal_point";
    case bundle::CameraParam::kExtra:
      return "extra";
    case bundle::CameraParam::kMetadata:
      return "metadata";
  }
  return "";
}

const char* ReachName(bundle::CameraReach reach) {
  switch (reach) {
    case bundle::CameraReach::kFront:
      return "front";
    case bundle::CameraReach::kBeyond:
      return "beyond";
    case bundle::CameraReach::kAll:
      return "all";
  }
  return "";
}

/// [(name, [(parameter, kind), ...], reach), ...]
py::list CameraModelList() {
  py::list models;
  for (int i = 0; i < bundle::kNumCameraModels; ++i) {
    const bundle::CameraModel& model = bundle::AllCameraModels()[i];
    py::list params;
    for (int j = 0; j < model.num_params; ++j) {
      params.append(py::make_tuple(model.params[j].name, KindName(model.params[j].kind)));
    }
    models.append(py::make_tuple(model.name, params, ReachName(model.reach)));
  }
  return models;
}

/// Python checks the shapes. Returns (xy, status, d_point | None, d_params | None).
py::tuple ProjectPoints(const std::string& name, const CastArray<double>& params,
                        const CastArray<double>& points, bool jacobians) {
  const bundle::CameraModel& model = *bundle::FindCameraModel(name);
  const py::ssize_t n = points.shape(0);
  CastArray<double> xy({n, py::ssize_t{2}});
  py::array_t<int8_t> status(n);
  CastArray<double> d_point({jacobians ? n : 0, py::ssize_t{2}, py::ssize_t{3}});
  CastArray<double> d_params(
      {jacobians ? n : 0, py::ssize_t{2}, static_cast<py::ssize_t>(model.num_params)});
  const double* point_data = points.data();
  const double* param_data = params.data();
  double* xy_data = xy.mutable_data();
  int8_t* status_data = status.mutable_data();
  double* d_point_data = d_point.mutable_data();
  double* d_params_data = d_params.mutable_data();
  {
    ReleaseGil release;
    for (py::ssize_t i = 0; i < n; ++i) {
      status_data[i] = static_cast<int8_t>(
          model.project(param_data, point_data + 3 * i, xy_data + 2 * i,
                        jacobians ? d_point_data + 6 * i : nullptr,
                        jacobians ? d_params_data + 2 * model.num_params * i : nullptr));
    }
  }
  if (!jacobians) return py::make_tuple(xy, status, py::none(), py::none());
  return py::make_tuple(xy, status, d_point, d_params);
}

}  // namespace

void BindCameras(py::module_& m) {
  m.attr("PROJECTION_VALID") = static_cast<int>(bundle::Projection::kValid);
  m.attr("PROJECTION_BEHIND") = static_cast<int>(bundle::Projection::kBehind);
  m.attr("PROJECTION_UNDEFINED") = static_cast<int>(bundle::Projection::kUndefined);
  m.def("camera_models", &CameraModelList);
  m.def("project", &ProjectPoints, py::arg("model"), py::arg("params"), py::arg("points"),
        py::arg("jacobians"));
}
