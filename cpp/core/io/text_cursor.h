#pragma once

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "core/error.h"
#include "core/io/input_file.h"
#include "core/io/printable.h"

namespace bundle {

/// Walks through a text of white-space separated numbers, of any size, in a buffer of fixed size.
///
/// The point of the class is speed: the common case is one std::from_chars on the buffer. A number
/// that does not please is left under the cursor, so that Fail() can show it.
class TextCursor {
 public:
  /// `on_block` is called between blocks of about a megabyte; it may throw to end the reading.
  TextCursor(InputFile& file, std::function<void()> on_block)
      : file_(file), on_block_(std::move(on_block)), buffer_(kBufferSize) {
    position_ = end_ = buffer_.data();
  }

  /// Reads a number of type T that fills its token and satisfies `accept(value)`; otherwise returns
  /// false and stays before it.
  template <typename T, typename Accept>
  bool Read(T* value, Accept accept) {
    if (end_ - position_ < kEnoughAhead) Refill();
    SkipSpace();
    const auto [stop, error] = std::from_chars(position_, end_, *value);
    if (error != std::errc() || stop == end_ || !IsSpace(*stop)) return ReadSlowly(value, accept);
    if (!accept(*value)) return false;
    position_ = stop;
    return true;
  }

  /// Skips white space and tells whether the text ends there.
  bool AtEnd() {
    SkipSpace();
    return position_ == end_;
  }

  /// Throws the InputError `NAME:LINE: expected EXPECTED, found ...` for what is under the cursor.
  [[noreturn]] void Fail(const std::string& expected) {
    SkipSpace();
    const std::string_view token = Token();
    FailWith(expected,
             token.empty() ? "the end of the file" : "'" + Printable(token, kShownBytes) + "'");
  }

  [[noreturn]] void FailWith(const std::string& expected, const std::string& found) const {
    throw InputError(file_.name() + ":" + std::to_string(line_) + ": expected " + expected +
                     ", found " + found);
  }

 private:
  static constexpr size_t kBufferSize = size_t{1} << 20;
  static constexpr ptrdiff_t kEnoughAhead = 256;  ///< bytes that hold white space and a number
  static constexpr size_t kLongestNumber = 4096;  ///< a longer token is no number
  static constexpr size_t kShownBytes = 40;

  static bool IsSpace(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

  void SkipSpace() {
    do {
      for (; position_ < end_; ++position_) {
        if (!IsSpace(*position_)) return;
        line_ += *position_ == '\n';
      }
    } while (Refill());
  }

  /// Everything Read() is too hasty for: a leading plus, a number at the end of the buffer.
  template <typename T, typename Accept>
  bool ReadSlowly(T* value, Accept accept) {
    const std::string_view token = Token();
    if (token.size() > kLongestNumber) return false;
    const char* first = token.data();
    const char* last = first + token.size();
    if (token.size() > 1 && first[0] == '+' && first[1] != '-') ++first;
    const auto [stop, error] = std::from_chars(first, last, *value);
    if (error != std::errc() || stop != last || !accept(*value)) return false;
    position_ = last;
    return true;
  }

  /// The token under the cursor, as much of it as the buffer can hold.
  std::string_view Token() {
    size_t size = 0;
    do {
      while (position_ + size < end_ && !IsSpace(position_[size])) ++size;
    } while (position_ + size == end_ && Refill());
    return {position_, size};
  }

  /// Moves what is not yet read to the front of the buffer and reads more behind it. Returns false
  /// if nothing came: the file has ended or the buffer is full.
  bool Refill() {
    const auto left = static_cast<size_t>(end_ - position_);
    if (at_end_ || left == buffer_.size()) return false;
    if (on_block_) on_block_();
    std::memmove(buffer_.data(), position_, left);
    const size_t count = file_.Read(buffer_.data() + left, buffer_.size() - left);
    position_ = buffer_.data();
    end_ = position_ + left + count;
    at_end_ = count == 0;
    return count > 0;
  }

  InputFile& file_;
  std::function<void()> on_block_;
  std::vector<char> buffer_;
  const char* position_;
  const char* end_;
  int64_t line_ = 1;
  bool at_end_ = false;
};

}  // namespace bundle
