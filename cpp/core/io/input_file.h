#pragma once

/// Files read as streams and decompressed while reading.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace bundle {

/// Byte order mark, with which editors on Windows begin UTF-8 files.
inline constexpr std::string_view kByteOrderMark = "\xef\xbb\xbf";

/// A file as a stream of bytes. It is decompressed if it begins like a gzip or bzip2 file, whatever
/// its name. Concatenated streams, as pigz and pbzip2 write them, are read as one. The byte order
/// mark of a text file is skipped.
///
/// System errors are thrown as std::system_error, damaged compressed data as InputError with the
/// position in the stored file.
class InputFile {
 public:
  static std::unique_ptr<InputFile> Open(const std::filesystem::path& path);
  virtual ~InputFile() = default;

  /// Reads up to `size` > 0 bytes into `buffer`; returns their number, 0 only at the end.
  virtual size_t Read(char* buffer, size_t size) = 0;

  /// The name as messages print it.
  virtual const std::string& name() const = 0;

  /// Size on disk in bytes; 0 for a pipe or a device.
  virtual uint64_t stored_size() const = 0;

  virtual bool is_compressed() const = 0;
};

/// Throws InputError: a file has changed between two readings. `name`: the file, for the message;
/// "" if the caller adds it.
[[noreturn]] void FailAsChanged(const std::string& name = "");

/// Number of bytes that readers of text read at a time.
inline constexpr size_t kReadBlockSize = size_t{1} << 20;

}  // namespace bundle
