#pragma once

#include <charconv>
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/io/output_file.h"

namespace bundle {

/// Numbers as text, the shortest that read back as the same value. Collects numbers and words and
/// passes them on in blocks, each to all files.
class NumberWriter {
 public:
  /// `on_block` is called between blocks; it may throw to end the writing. Keeps references.
  NumberWriter(std::vector<OutputFile*> files, const std::function<void()>& on_block)
      : files_(std::move(files)), on_block_(on_block), buffer_(OutputFile::kBlockSize, '\0') {}

  template <typename T>
  void Write(T value, char separator) {
    if (buffer_.size() - used_ < kLongestItem) Flush();
    char* end = buffer_.data() + buffer_.size();
    char* stop = std::to_chars(buffer_.data() + used_, end, value).ptr;
    *stop++ = separator;
    used_ = static_cast<size_t>(stop - buffer_.data());
  }

  /// A word of at most 30 bytes.
  void WriteWord(std::string_view word, char separator) {
    if (buffer_.size() - used_ < kLongestItem) Flush();
    used_ += word.copy(buffer_.data() + used_, kLongestItem - 1);
    buffer_[used_++] = separator;
  }

  void Flush() {
    if (on_block_) on_block_();
    for (OutputFile* file : files_) file->Write(std::string_view(buffer_).substr(0, used_));
    used_ = 0;
  }

 private:
  static constexpr size_t kLongestItem = 32;

  std::vector<OutputFile*> files_;
  const std::function<void()>& on_block_;
  std::string buffer_;
  size_t used_ = 0;
};

}  // namespace bundle
