#include <pybind11/pybind11.h>

#include <utility>

#include "bindings/columns.h"
#include "bindings/file_access.h"
#include "core/io/json_models.h"

namespace py = pybind11;

namespace bundle {
namespace {

py::dict OpenMvg(const py::object& path, const py::object& progress) {
  OpenMvgStructure data = ReadFile(path, ReadOpenMvg, progress);
  py::dict found;
  found["rest"] = py::bytes(data.rest);
  found["ids"] = Column(std::move(data.ids));
  found["points"] = Rows(std::move(data.points), 3);
  found["num_views"] = Column(std::move(data.num_views));
  found["view"] = Column(std::move(data.view));
  found["feature"] = Column(std::move(data.feature));
  found["xy"] = Rows(std::move(data.xy), 2);
  return found;
}

py::dict OpenSfm(const py::object& path, int64_t entry, const py::object& progress) {
  OpenSfmPoints data = ReadFile(
      path,
      [&](const auto& file, const auto& on_block) { return ReadOpenSfm(file, entry, on_block); },
      progress);
  py::dict found;
  found["rest"] = py::bytes(data.rest);
  found["names"] = py::bytes(data.names.text);
  found["ends"] = Column(std::move(data.names.ends));
  found["ids"] = Column(std::move(data.ids));
  found["points"] = Rows(std::move(data.points), 3);
  found["colors"] = Rows(std::move(data.colors), 3);
  return found;
}

}  // namespace
}  // namespace bundle

void BindJsonModels(py::module_& m) {
  m.def("read_openmvg", &bundle::OpenMvg, py::arg("path"), py::arg("progress") = py::none());
  m.def("read_opensfm", &bundle::OpenSfm, py::arg("path"), py::arg("entry"),
        py::arg("progress") = py::none());
}
