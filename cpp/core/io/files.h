#pragma once

/// Files as streams: read and decompressed, compressed and written; and their bytes in messages.

#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <future>
#include <memory>
#include <string>
#include <string_view>

namespace bundle {

/// Bytes of a file or of its name, fit for one line of a message: valid UTF-8 stays, control
/// characters, line separators and bytes that are no UTF-8 become \xNN, and from `max_bytes` input
/// bytes on there is "...".
std::string Printable(std::string_view bytes, size_t max_bytes = std::string_view::npos);

/// The text, fit for a message and not too long for it, in quotes.
std::string Quoted(std::string_view text);

/// A file as a stream of bytes, decompressed on the way if its first bytes say gzip or bzip2 (the
/// name does not matter). Concatenated streams, as pigz and pbzip2 write them, are read as one.
///
/// What goes wrong in the system is thrown as std::system_error, damaged compressed data as
/// InputError with the position in the file as it is stored.
class InputFile {
 public:
  static std::unique_ptr<InputFile> Open(const std::filesystem::path& path);
  virtual ~InputFile() = default;

  /// Reads up to `size` > 0 bytes into `buffer`; returns how many, 0 only at the end.
  virtual size_t Read(char* buffer, size_t size) = 0;

  /// The name as messages print it.
  virtual const std::string& name() const = 0;

  /// Size on disk in bytes, 0 for a pipe or a device.
  virtual uint64_t stored_size() const = 0;

  virtual bool is_compressed() const = 0;
};

/// Throws InputError: what is read again is not what was read before. `name`: of the file, for
/// messages; "" where the caller adds it.
[[noreturn]] void FailAsChanged(const std::string& name = "");

/// What readers of text take at a time.
inline constexpr size_t kReadBlockSize = size_t{1} << 20;

enum class Compression { kNone, kGzip, kBzip2 };

/// A file to write, compressed on the way. Compression runs on all cores: the file is a sequence of
/// independent streams of about a megabyte, which every gzip and bzip2 tool reads as one.
///
/// Throws std::system_error, also for errors that the system reports late; only after Close() has
/// returned is everything handed to the system.
class OutputFile {
 public:
  OutputFile(const std::filesystem::path& path, Compression compression);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  /// Adds a block; blocks of kBlockSize are best.
  void Write(std::string_view block);
  /// Replaces bytes that were written, of a file that is not compressed.
  void Overwrite(int64_t position, std::string_view bytes);
  void Close();

  static constexpr size_t kBlockSize = 900'000;  ///< what bzip2 compresses at a time

 private:
  void WriteToSystem(std::string_view bytes);
  void FinishOldestStream();
  [[noreturn]] void ThrowSystemError() const;

  std::filesystem::path path_;
  Compression compression_;
  int fd_;
  std::deque<std::future<std::string>> streams_;  ///< being compressed, oldest first
};

}  // namespace bundle
