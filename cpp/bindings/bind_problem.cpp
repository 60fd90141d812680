#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>
#include <string_view>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/to_numpy.h"
#include "core/error.h"
#include "core/interface/adjustment_problem.h"
#include "core/io/printable.h"
#include "core/problem/reprojection_errors.h"
#include "core/scratch/large_vector.h"

namespace py = pybind11;

namespace {

/// Checks that a name can be written into a file and a line of a report.
void CheckImageName(int64_t image_id, const py::handle& name) {
  const std::string place = "image_names: image " + std::to_string(image_id) + ": ";
  if (!py::isinstance<py::str>(name)) {
    throw bundle::InputError(place + "expected a string, found " +
                             std::string(py::str(py::type::of(name).attr("__name__"))));
  }
  Py_ssize_t size = 0;
  const char* text = PyUnicode_AsUTF8AndSize(name.ptr(), &size);
  if (text == nullptr) PyErr_Clear();  // a surrogate, which UTF-8 cannot encode
  const std::string_view bytes(text == nullptr ? "" : text, static_cast<size_t>(size));
  if (text == nullptr || bundle::Printable(bytes) != bytes) {
    const auto escaped = py::reinterpret_steal<py::str>(PyObject_ASCII(name.ptr()));
    throw bundle::InputError(place + "expected a name in UTF-8 without control characters, found " +
                             std::string(escaped));
  }
}

void Validate(const py::object& problem) {
  const bundle::ProblemView view = ViewProblem(problem);
  const py::object names = problem.attr("image_names");
  for (int i = 0; i < view.num_images; ++i) {
    CheckImageName(view.image_ids[i], names[py::int_(i)]);
  }
  ReleaseGil release;
  bundle::ValidateProblem(view);
}

py::tuple ReprojectionErrors(const py::object& problem, int num_threads,
                             const std::string& cheirality) {
  const bundle::ProblemView view = ViewProblem(problem);
  bundle::LargeVector<double> errors(view.num_observations);
  bundle::LargeVector<uint8_t> behind(view.num_observations);
  const bundle::Cheirality named = CheiralityFromName(cheirality);
  {
    ReleaseGil release;
    bundle::ComputeReprojectionErrors(view, num_threads, named, errors.data(), behind.data());
  }
  const py::ssize_t size = view.num_observations;
  return py::make_tuple(ToNumpy(std::move(errors), {size}),
                        ToNumpy(std::move(behind), {size}).attr("view")(py::dtype::of<bool>()));
}

py::tuple ReprojectionResiduals(const py::object& problem, int num_threads,
                                const std::string& cheirality) {
  const bundle::ProblemView view = ViewProblem(problem);
  py::array_t<double> residuals({py::ssize_t{view.num_observations}, py::ssize_t{2}});
  py::array_t<bool> behind(view.num_observations);
  const bundle::Cheirality named = CheiralityFromName(cheirality);
  double* residuals_data = residuals.mutable_data();
  auto* behind_data = reinterpret_cast<uint8_t*>(behind.mutable_data());
  {
    ReleaseGil release;
    bundle::ComputeReprojectionResiduals(view, num_threads, named, residuals_data, behind_data);
  }
  return py::make_tuple(residuals, behind);
}

/// Returns (residual, d_pose, d_params, d_point, d_twist); `rotation_offsets` is (num_images, 3).
py::tuple LinearizeObservations(const py::object& problem, const std::string& cheirality,
                                const Array<double>& rotation_offsets) {
  const bundle::ProblemView view = ViewProblem(problem);
  const py::ssize_t n = view.num_observations, two = 2;
  py::array_t<double> residual({n, two});
  py::array_t<double> d_pose({n, two, py::ssize_t{6}});
  py::array_t<double> d_params({n, two, py::ssize_t{view.camera_params_stride}});
  py::array_t<double> d_point({n, two, py::ssize_t{3}});
  py::array_t<double> d_twist({n, two, py::ssize_t{6}});
  const bundle::ReprojectionDerivatives out{residual.mutable_data(), d_pose.mutable_data(),
                                            d_params.mutable_data(), d_point.mutable_data(),
                                            d_twist.mutable_data()};
  const double* offsets = rotation_offsets.data();
  const bundle::Cheirality named = CheiralityFromName(cheirality);
  {
    ReleaseGil release;
    bundle::Linearize(view, offsets, named, out);
  }
  return py::make_tuple(residual, d_pose, d_params, d_point, d_twist);
}

}  // namespace

void BindProblem(py::module_& m) {
  m.def("validate", &Validate, py::arg("problem"));
  m.def("freeze", &Freeze, py::arg("array"));
  m.def("is_immutable", &IsImmutable, py::arg("array"));
  m.def("reprojection_errors", &ReprojectionErrors, py::arg("problem"), py::arg("num_threads"),
        py::arg("cheirality"));
  m.def("reprojection_residuals", &ReprojectionResiduals, py::arg("problem"),
        py::arg("num_threads"), py::arg("cheirality"));
  m.def("linearize", &LinearizeObservations, py::arg("problem"), py::arg("cheirality"),
        py::arg("rotation_offsets"));
}
