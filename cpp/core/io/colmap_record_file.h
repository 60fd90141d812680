#pragma once

#include <array>
#include <charconv>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include "core/io/colmap_index.h"
#include "core/io/output_file.h"

namespace bundle {

/// One file of a model: values one after the other, in either format. In a text file, blanks
/// separate the values, and counts are in comments only.
class RecordFile {
 public:
  /// `comments`: the first lines of a text file, without "#" and without the last line end.
  RecordFile(const std::filesystem::path& folder, const char* stem, bool is_binary, int digits,
             std::string_view comments, size_t count, std::function<void()> on_block = {})
      : file_(folder / (std::string(stem) + (is_binary ? ".bin" : ".txt")), Compression::kNone),
        is_binary_(is_binary),
        digits_(digits),
        on_block_(std::move(on_block)) {
    if (is_binary) {
      Raw(static_cast<uint64_t>(count));
    } else {
      buffer_.append(comments).append(std::to_string(count));
    }
  }

  /// Writes ", WORDS: MEAN" after the count of a text file.
  void Mean(const char* words, size_t sum, size_t count) {
    if (is_binary_) return;
    buffer_.append(words);
    AppendNumber(count == 0 ? 0.0 : static_cast<double>(sum) / static_cast<double>(count));
  }

  void BeginRecord() {
    if (buffer_.size() >= OutputFile::kBlockSize) Flush();
    EndLine();
  }

  /// In text, starts a new line for the next values.
  void EndLine() {
    if (!is_binary_) buffer_ += '\n';
    at_begin_of_line_ = true;
  }

  template <typename T>
  void Integer(T value) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      char text[24];
      buffer_.append(text, std::to_chars(text, text + sizeof(text), +value).ptr);
    }
  }

  void Number(double value) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      AppendNumber(value);
    }
  }

  /// qw qx qy qz tx ty tz.
  void Pose(const std::array<double, 7>& pose) {
    for (const double value : pose) Number(value);
  }

  /// A value that is a number in binary files and a word in text files.
  template <typename T>
  void Named(T value, std::string_view name) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      buffer_.append(name);
    }
  }

  void Sensor(const ColmapIndex::Sensor& sensor) {
    Named(static_cast<int32_t>(sensor.type), sensor.type == SensorType::kCamera ? "CAMERA" : "IMU");
    Integer(sensor.id);
  }

  void Name(const std::string& name) {
    if (!is_binary_) Separate();
    buffer_.append(name);
    if (is_binary_) buffer_ += '\0';
  }

  /// Count that only binary files have.
  template <typename T>
  void BinaryCount(T count) {
    if (is_binary_) Raw(count);
  }

  /// COLMAP's text has a blank here, also at the end of a line.
  void Blank() {
    if (is_binary_) return;
    buffer_ += ' ';
    at_begin_of_line_ = true;
  }

  /// Called between blocks, after the first one.
  void MayFlush() {
    if (buffer_.size() >= OutputFile::kBlockSize) Flush();
  }

  void Close() {
    if (!is_binary_) buffer_ += '\n';
    Flush();
    file_.Close();
  }

 private:
  template <typename T>
  void Raw(T value) {
    buffer_.append(reinterpret_cast<const char*>(&value), sizeof(T));
  }

  void Separate() {
    if (!at_begin_of_line_) buffer_ += ' ';
    at_begin_of_line_ = false;
  }

  void AppendNumber(double value) {
    char text[40];
    char* const end = text + sizeof(text);
    const auto result = digits_ == 0
                            ? std::to_chars(text, end, value)
                            : std::to_chars(text, end, value, std::chars_format::general, digits_);
    buffer_.append(text, result.ptr);
  }

  void Flush() {
    if (on_block_) on_block_();
    file_.Write(buffer_);
    buffer_.clear();
  }

  OutputFile file_;
  bool is_binary_;
  int digits_;
  std::function<void()> on_block_;
  std::string buffer_;
  bool at_begin_of_line_ = true;
};

}  // namespace bundle
