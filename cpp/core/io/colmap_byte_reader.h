#pragma once

/// Bytes of a COLMAP file, and numbers of a binary one, read one after the other.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "core/io/colmap_index.h"
#include "core/words.h"

namespace bundle {

/// Bytes of a file: those in memory, or a block at a time from a stream.
class FileWindow {
 public:
  explicit FileWindow(const ModelFile& file) : file_(file), bytes_(file.contents()) {}
  FileWindow(const FileWindow&) = delete;
  FileWindow& operator=(const FileWindow&) = delete;

  /// `count` bytes from `position` on, which must be in the file. They are valid until the next
  /// call.
  const char* At(uint64_t position, size_t count) {
    if (position < begin_ || position + count > begin_ + bytes_.size()) Fill(position, count);
    return bytes_.data() + (position - begin_);
  }

  /// The bytes from `position` to the end of the block in memory, at least one. `position` must be
  /// in the file.
  std::string_view From(uint64_t position) {
    At(position, 1);
    return bytes_.substr(position - begin_);
  }

 private:
  static constexpr size_t kBlockSize = 1 << 20;

  void Fill(uint64_t position, size_t count) {
    const uint64_t num_left = file_.size() - position;
    buffer_.resize(std::max<uint64_t>(count, std::min<uint64_t>(kBlockSize, num_left)));
    file_.ReadAt(position, buffer_.data(), buffer_.size());
    begin_ = position;
    bytes_ = buffer_;
  }

  const ModelFile& file_;
  std::string_view bytes_;
  std::string buffer_;
  uint64_t begin_ = 0;
};

class ByteReader {
 public:
  explicit ByteReader(const ModelFile& file) : file_(file), window_(file) {}

  uint64_t position() const { return position_; }
  uint64_t num_left() const { return file_.size() - position_; }

  /// Reads the value at the cursor; `what` is its name for the error at the end of the file.
  template <typename T>
  T Read(const char* what) {
    T value;
    ReadArray(&value, 1, what);
    return value;
  }

  template <typename T>
  void ReadArray(T* values, size_t count, const char* what) {
    if (num_left() < count * sizeof(T)) {
      Fail(std::string("expected ") + what + " (" + std::to_string(count * sizeof(T)) +
           " bytes), found the end of the file after " + std::to_string(num_left()));
    }
    if (count == 0) return;
    std::memcpy(values, window_.At(position_, count * sizeof(T)), count * sizeof(T));
    position_ += count * sizeof(T);
  }

  /// Reads a count of records that take at least `min_size` bytes each.
  template <typename T>
  T ReadCount(const std::string& what, uint64_t min_size) {
    const uint64_t at = position_;
    const T count = Read<T>(("the number of " + what).c_str());
    if (count > num_left() / min_size) {
      file_.Fail(at, "expected at most " + std::to_string(num_left() / min_size) + " " + what +
                         " in the " + Counted(static_cast<int64_t>(num_left()), "byte") +
                         " that follow" + (num_left() == 1 ? "s" : "") + ", found " +
                         std::to_string(count));
    }
    return count;
  }

  /// Reads a text up to a zero byte. The result is valid until the next call of any function.
  std::string_view ReadName(const std::string& subject) {
    for (uint64_t most = 256;; most *= 4) {
      const auto size = static_cast<size_t>(std::min(most, num_left()));
      const std::string_view seen(size == 0 ? "" : window_.At(position_, size), size);
      const size_t end = seen.find('\0');
      if (end != std::string_view::npos) {
        position_ += end + 1;
        return seen.substr(0, end);
      }
      if (size == num_left()) {
        Fail(subject + ": expected a name that ends in a zero byte, found the end of the file");
      }
    }
  }

  uint32_t ReadId(const char* what) {
    const uint64_t at = position_;
    const auto id = Read<uint32_t>(what);
    if (id != kInvalidColmapId) return id;
    file_.Fail(at,
               std::string("expected ") + what + " below 4294967295, found " + std::to_string(id));
  }

  void ExpectEnd() const {
    if (num_left() == 0) return;
    Fail("expected the end of the file, found " + std::to_string(num_left()) + " more bytes");
  }

  [[noreturn]] void Fail(const std::string& message) const { file_.Fail(position_, message); }

 private:
  const ModelFile& file_;
  FileWindow window_;
  uint64_t position_ = 0;
};

}  // namespace bundle
