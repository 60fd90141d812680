#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>
#include <utility>

#include "core/io/colmap_checker.h"

namespace py = pybind11;

void BindColmap(py::module_& m) {
  m.def("is_colmap_model", &bundle::IsColmapModel, py::arg("folder"),
        py::call_guard<py::gil_scoped_release>());
  m.def(
      "check_colmap_model",
      [](const std::string& folder) {
        bundle::ColmapCheck check = bundle::CheckColmapModel(folder);
        return std::pair(check.binary, std::move(check.names_with_spaces));
      },
      py::arg("folder"), py::call_guard<py::gil_scoped_release>());
}
