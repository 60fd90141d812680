#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>
#include <utility>
#include <vector>

#include "bindings/immutable_array.h"
#include "core/io/colmap_checker.h"

namespace py = pybind11;

namespace bundle {
namespace {

py::tuple CheckModel(const std::string& folder) {
  ColmapCheck check;
  {
    const py::gil_scoped_release release;
    check = CheckColmapModel(folder);
  }
  ColmapObservations& observations = check.observations;
  const auto size = static_cast<py::ssize_t>(observations.image.size());
  return py::make_tuple(check.binary, check.names_with_spaces,
                        ToImmutableNumpy(std::move(observations.image), {size}),
                        ToImmutableNumpy(std::move(observations.point), {size}),
                        ToImmutableNumpy(std::move(observations.keypoint), {size}),
                        ToImmutableNumpy(std::move(observations.xy), {size, 2}));
}

}  // namespace
}  // namespace bundle

void BindColmap(py::module_& m) {
  m.def("check_colmap_model", &bundle::CheckModel, py::arg("folder"));
}
