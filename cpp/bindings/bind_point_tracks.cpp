#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "bindings/columns.h"
#include "bindings/file_access.h"
#include "bindings/gil.h"
#include "core/io/input_file.h"
#include "core/io/point_tracks.h"

namespace py = pybind11;

namespace bundle {
namespace {

/// Calls `read(path, on_block)` without the GIL and returns the tracks by name.
template <typename Read>
py::dict ReadTracks(const py::object& given_path, const py::object& progress, Read read) {
  const std::filesystem::path path = PathFromPython(given_path);
  BlockWatch watch(progress, kReadBlockSize);
  PointTracks tracks;
  try {
    const ReleaseGil release;
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
                 const py::bytes& names, const py::array_t<int64_t>& ends,
                 const py::object& progress) {
  const auto text = static_cast<std::string_view>(names);
  std::vector<std::string_view> tracks;
  tracks.reserve(static_cast<size_t>(ends.size()));
  size_t begin = 0;
  for (py::ssize_t k = 0; k < ends.size(); ++k) {
    const auto end = static_cast<size_t>(ends.at(k));
    tracks.push_back(text.substr(begin, end - begin));
    begin = end;
  }
  return ReadTracks(path, progress, [&](const auto& file, const auto& on_block) {
    return ReadTracksCsv(file, {images.begin(), images.end()}, tracks, on_block);
  });
}

}  // namespace
}  // namespace bundle

void BindPointTracks(py::module_& m) {
  m.def("read_point_tracks", &bundle::ReadPoints, py::arg("path"), py::arg("skip"),
        py::arg("num_lines"), py::arg("num_images"), py::arg("num_points"),
        py::arg("progress") = py::none());
  m.def("read_tracks_csv", &bundle::ReadCsv, py::arg("path"), py::arg("images"), py::arg("names"),
        py::arg("ends"), py::arg("progress") = py::none());
}
