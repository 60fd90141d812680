#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

namespace bundle {

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
