#pragma once

/// Common parts of the bindings of readers and writers of files.

#include <pybind11/pybind11.h>
#include <pybind11/stl/filesystem.h>

#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <system_error>

#include "bindings/gil.h"
#include "core/error.h"
#include "core/io/input_file.h"
#include "core/io/output_file.h"

namespace bundle {

/// Makes Ctrl-C end the reading or writing of a large file.
inline void CheckSignals() {
  const HoldGil held;
  if (PyErr_CheckSignals() != 0) throw pybind11::error_already_set();
}

/// Callback of readers and writers of text, between blocks. Handles Ctrl-C, and passes the
/// approximate number of bytes so far to `progress`, unless it is None. Keeps a reference to
/// `progress`.
class BlockWatch {
 public:
  BlockWatch(const pybind11::object& progress, int64_t bytes_per_block)
      : progress_(progress), bytes_per_block_(bytes_per_block) {}

  std::function<void()> OnBlock() {
    return [this] {
      const HoldGil held;
      if (PyErr_CheckSignals() != 0) throw pybind11::error_already_set();
      if (!progress_.is_none()) CallPython(progress_, pybind11::make_tuple(bytes_));
      bytes_ += bytes_per_block_;
    };
  }

 private:
  const pybind11::object& progress_;
  int64_t bytes_per_block_;
  int64_t bytes_ = 0;
};

/// A str, bytes or os.PathLike. pybind11's own conversion would raise TypeError if a signal arrives
/// while Python code of the path runs.
inline std::filesystem::path PathFromPython(const pybind11::object& given) {
  PyObject* bytes = nullptr;
  if (PyUnicode_FSConverter(given.ptr(), &bytes) == 0) throw pybind11::error_already_set();
  return pybind11::cast<std::string>(pybind11::reinterpret_steal<pybind11::bytes>(bytes));
}

[[noreturn]] inline void ThrowOsError(const std::system_error& error,
                                      const std::filesystem::path& path) {
  const pybind11::str name(pybind11::cast(path));
  errno = error.code().value();
  // The path as a string: OSError prints the representation, which is not readable for a
  // pathlib.Path.
  PyErr_SetFromErrnoWithFilenameObject(PyExc_OSError, name.ptr());
  throw pybind11::error_already_set();
}

/// Calls `read(path, on_block)` without the GIL, for readers with blocks of kReadBlockSize.
template <typename Read>
auto ReadFile(const pybind11::object& given_path, Read read,
              const pybind11::object& progress = pybind11::none()) {
  const std::filesystem::path path = PathFromPython(given_path);
  BlockWatch watch(progress, kReadBlockSize);
  try {
    const ReleaseGil release;
    return read(path, watch.OnBlock());
  } catch (const std::system_error& error) {
    ThrowOsError(error, path);
  }
}

inline Compression CompressionFromName(const std::string& name) {
  if (name == "gzip") return Compression::kGzip;
  if (name == "bzip2") return Compression::kBzip2;
  if (name.empty()) return Compression::kNone;
  throw InputError("compression: expected gzip, bzip2 or nothing, found " + name);
}

}  // namespace bundle
