#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "bindings/file_access.h"
#include "bindings/immutable_array.h"
#include "core/io/input_file.h"
#include "core/io/point_tracks.h"

namespace py = pybind11;

namespace bundle {
namespace {

template <typename T>
py::array Column(std::vector<T> values) {
  const auto count = static_cast<py::ssize_t>(values.size());
  return ToImmutableNumpy(std::move(values), {count});
}

template <typename T>
py::array Rows(std::vector<T> values, py::ssize_t width) {
  const auto count = static_cast<py::ssize_t>(values.size()) / width;
  return ToImmutableNumpy(std::move(values), {count, width});
}

/// Calls `read(path, on_block)` without the GIL and returns the tracks by name.
template <typename Read>
py::dict ReadTracks(const py::object& given_path, const py::object& progress, Read read) {
  const std::filesystem::path path = PathFromPython(given_path);
  BlockWatch watch(progress, kReadBlockSize);
  PointTracks tracks;
  try {
    const py::gil_scoped_release release;
    tracks = read(path, watch.OnBlock());
  } catch (const std::system_error& error) {
    ThrowOsError(error, path);
  }
  py::dict found;
  found["points"] = Rows(std::move(tracks.points), 3);
  found["colors"] = Rows(std::move(tracks.colors), 3);
  found["image"] = Column(std::move(tracks.image));
  found["point"] = Column(std::move(tracks.point));
  found["key"] = Column(std::move(tracks.key));
  found["xy"] = Rows(std::move(tracks.xy), 2);
  found["scale"] = Column(std::move(tracks.scale));
  found["num_skipped"] = tracks.num_skipped;
  found["next"] = py::bytes(tracks.next);
  found["next_line"] = tracks.next_line;
  return found;
}

py::dict ReadPoints(const py::object& path, int64_t skip, int64_t num_lines, int64_t num_images,
                    int64_t num_points, const py::object& progress) {
  return ReadTracks(path, progress, [&](const auto& file, const auto& on_block) {
    return ReadPointTracks(file, skip, num_lines, num_images, num_points, on_block);
  });
}

py::dict ReadCsv(const py::object& path, const std::vector<std::string>& images,
                 const std::vector<std::string>& tracks, const py::object& progress) {
  return ReadTracks(path, progress, [&](const auto& file, const auto& on_block) {
    return ReadTracksCsv(file, images, tracks, on_block);
  });
}

}  // namespace
}  // namespace bundle

void BindPointTracks(py::module_& m) {
  m.def("read_point_tracks", &bundle::ReadPoints, py::arg("path"), py::arg("skip"),
        py::arg("num_lines"), py::arg("num_images"), py::arg("num_points"),
        py::arg("progress") = py::none());
  m.def("read_tracks_csv", &bundle::ReadCsv, py::arg("path"), py::arg("images"), py::arg("tracks"),
        py::arg("progress") = py::none());
}
