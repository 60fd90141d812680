#pragma once

/// Files written as streams, optionally compressed.

#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <future>
#include <string>
#include <string_view>

namespace bundle {

enum class Compression { kNone, kGzip, kBzip2 };

/// A file for writing, optionally compressed. Compression uses all cores: the file is a sequence of
/// independent streams of about a megabyte, which every gzip and bzip2 tool reads as one.
///
/// Throws std::system_error, also for errors that the system reports late. All data are passed to
/// the system only when Close() has returned.
class OutputFile {
 public:
  OutputFile(const std::filesystem::path& path, Compression compression);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  /// Adds a block; blocks of kBlockSize are best.
  void Write(std::string_view block);
  /// Replaces bytes that were already written, in a file without compression.
  void Overwrite(int64_t position, std::string_view bytes);
  void Close();

  static constexpr size_t kBlockSize = 900'000;  ///< bytes that bzip2 compresses at a time

 private:
  void WriteToSystem(std::string_view bytes);
  void FinishOldestStream();
  [[noreturn]] void ThrowSystemError() const;

  std::filesystem::path path_;
  Compression compression_;
  int fd_;
  std::deque<std::future<std::string>> streams_;  ///< streams being compressed, oldest first
};

}  // namespace bundle
