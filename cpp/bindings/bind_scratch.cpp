#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <utility>

#include "bindings/to_numpy.h"
#include "core/scratch/large_vector.h"
#include "core/scratch/scratch_files.h"

namespace py = pybind11;

namespace {

/// A writable array of the scratch folder, if one is open.
py::array LargeArray(py::ssize_t size, const py::dtype& dtype) {
  bundle::LargeVector<uint8_t> bytes(static_cast<size_t>(size * dtype.itemsize()));
  const auto count = static_cast<py::ssize_t>(bytes.size());
  return ToNumpy(std::move(bytes), {count}).attr("view")(dtype);
}

py::tuple Use() {
  const bundle::ScratchUse use = bundle::MeasureScratch();
  return py::make_tuple(use.bytes, use.peak_bytes);
}

}  // namespace

void BindScratch(py::module_& m) {
  m.def(
      "open_scratch",
      [](const std::string& folder, int64_t resident_bytes) {
        bundle::OpenScratch(folder, resident_bytes);
      },
      py::arg("folder"), py::arg("resident_bytes"));
  m.def("close_scratch", &bundle::CloseScratch);
  m.def("scratch_use", &Use);
  m.def("large_array", &LargeArray, py::arg("size"), py::arg("dtype"));
}
