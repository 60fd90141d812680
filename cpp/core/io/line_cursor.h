#pragma once

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/io/input_file.h"
#include "core/io/printable.h"
#include "core/io/text_cursor.h"

namespace bundle {

/// Reads a text of any size record by record, and within a line token by token. A record is a line
/// that is neither blank nor a comment ("#"). Each line is completely in memory, in a buffer that
/// is reused.
class LineCursor {
 public:
  /// `on_block` is called between blocks of about a megabyte; it may throw to end the reading.
  LineCursor(InputFile& file, std::function<void()> on_block)
      : file_(file), on_block_(std::move(on_block)), buffer_(kReadBlockSize) {
    next_line_ = end_ = buffer_.data();
  }

  /// Moves to the next record; false at the end of the file.
  bool NextRecord() {
    while (NextLine()) {
      if (!AtEndOfLine() && *cursor_ != '#') return true;
    }
    return false;
  }

  /// Moves to the next line, with any content; false at the end of the file.
  bool NextLine() {
    const char* stop = nullptr;
    size_t searched = 0;
    for (;;) {
      const auto ahead = static_cast<size_t>(end_ - next_line_);
      stop = static_cast<const char*>(std::memchr(next_line_ + searched, '\n', ahead - searched));
      if (stop != nullptr) break;
      searched = ahead;
      if (Refill()) continue;
      if (next_line_ == end_) return false;
      stop = end_;  // the last line has no line end
      break;
    }
    ++line_;
    cursor_ = next_line_;
    end_of_line_ = stop;
    next_line_ = stop == end_ ? stop : stop + 1;
    return true;
  }

  /// The rest of the line without its line end.
  std::string_view Line() const { return {cursor_, static_cast<size_t>(end_of_line_ - cursor_)}; }

  /// Number of the current line, from 1.
  int64_t line() const { return line_; }

  bool AtEndOfLine() {
    while (cursor_ < end_of_line_ && IsSpace(*cursor_)) ++cursor_;
    return cursor_ == end_of_line_;
  }

  /// The next token of the line; empty at its end.
  std::string_view Token() {
    AtEndOfLine();
    const char* const begin = cursor_;
    while (cursor_ < end_of_line_ && !IsSpace(*cursor_)) ++cursor_;
    return {begin, static_cast<size_t>(cursor_ - begin)};
  }

  /// Reads a number that fills its token and satisfies `accept(value)`; otherwise returns false and
  /// stays before the token.
  template <typename T, typename Accept>
  bool Read(T* value, Accept accept) {
    AtEndOfLine();
    const char* first = cursor_;
    if (end_of_line_ - first > 1 && first[0] == '+' && first[1] != '-') ++first;
    const auto [stop, error] = std::from_chars(first, end_of_line_, *value);
    if (error != std::errc() || (stop != end_of_line_ && !IsSpace(*stop)) || !accept(*value)) {
      return false;
    }
    cursor_ = stop;
    return true;
  }

  /// Throws the InputError `NAME:LINE: expected EXPECTED, found ...` for the token under the
  /// cursor.
  [[noreturn]] void Fail(const std::string& expected) {
    const std::string_view token = Token();
    FailWith(expected, token.empty() ? "the end of the line" : Quoted(token));
  }

  [[noreturn]] void FailWith(const std::string& expected, const std::string& found) const {
    FailAt(line_, expected, found);
  }

  [[noreturn]] void FailAt(int64_t line, const std::string& expected,
                           const std::string& found) const {
    throw InputError(file_.name() + ":" + std::to_string(line) + ": expected " + expected +
                     ", found " + found);
  }

 private:
  static constexpr size_t kLongestLine = size_t{1} << 24;

  /// Moves the incomplete line to the front and reads more data after it.
  bool Refill() {
    if (at_end_) return false;
    if (on_block_) on_block_();
    const auto left = static_cast<size_t>(end_ - next_line_);
    if (left > kLongestLine) {
      FailAt(line_ + 1, "a line of at most 16 MB", "a longer one");
    }
    std::vector<char> larger;
    if (2 * left > buffer_.size()) larger.resize(2 * buffer_.size());
    std::vector<char>& target = larger.empty() ? buffer_ : larger;
    std::memmove(target.data(), next_line_, left);
    if (!larger.empty()) buffer_.swap(larger);
    const size_t count = file_.Read(buffer_.data() + left, buffer_.size() - left);
    next_line_ = buffer_.data();
    end_ = next_line_ + left + count;
    at_end_ = count == 0;
    return count > 0;
  }

  InputFile& file_;
  std::function<void()> on_block_;
  std::vector<char> buffer_;
  const char* next_line_;
  const char* end_;
  const char* cursor_ = nullptr;
  const char* end_of_line_ = nullptr;
  int64_t line_ = 0;
  bool at_end_ = false;
};

}  // namespace bundle
