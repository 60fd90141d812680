#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include "bindings/problem_from_python.h"
#include "core/problem/reprojection_errors.h"
#include "core/problem/validate.h"

namespace py = pybind11;

namespace {

void Validate(const py::object& problem) {
  const bundle::ProblemView view = ViewProblem(problem);
  py::gil_scoped_release release;
  bundle::ValidateProblem(view);
}

py::tuple ReprojectionErrors(const py::object& problem, int num_threads) {
  const bundle::ProblemView view = ViewProblem(problem);
  py::array_t<double> errors(view.num_observations);
  py::array_t<bool> behind(view.num_observations);
  double* errors_data = errors.mutable_data();
  auto* behind_data = reinterpret_cast<uint8_t*>(behind.mutable_data());
  {
    py::gil_scoped_release release;
    bundle::ComputeReprojectionErrors(view, num_threads, errors_data, behind_data);
  }
  return py::make_tuple(errors, behind);
}

}  // namespace

void BindProblem(py::module_& m) {
  m.def("validate", &Validate, py::arg("problem"));
  m.def("reprojection_errors", &ReprojectionErrors, py::arg("problem"), py::arg("num_threads"));
}
