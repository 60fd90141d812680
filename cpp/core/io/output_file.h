#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <future>
#include <memory>
#include <string>
#include <string_view>

namespace bundle {

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

/// One file of a model, read whole, and the place that every complaint about it names.
class ModelFile {
 public:
  enum class Kind { kText, kBinary };

  ModelFile() = default;

  /// Throws InputError when the file cannot be opened, is no regular file or cannot be read.
  ModelFile(std::string path, Kind kind);

  const std::string& path() const { return path_; }
  std::string_view contents() const { return {contents_.get(), size_}; }

  /// Frees the contents; `Fail` goes on working.
  void Release();

  /// Throws InputError "PATH:POSITION: message" (a line, counted from 1) for text and
  /// "PATH: byte POSITION: message" (an offset, counted from 0) for binary.
  [[noreturn]] void Fail(uint64_t position, const std::string& message) const;

 private:
  std::string path_;
  Kind kind_ = Kind::kText;
  std::unique_ptr<char[]> contents_;
  size_t size_ = 0;
};

/// The text, fit for a message and not too long for it, in quotes.
std::string Quoted(std::string_view text);

}  // namespace bundle
