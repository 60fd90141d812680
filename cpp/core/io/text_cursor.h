#pragma once

/// Cursors over text, with the place of each error: numbers in a stream of any size (BAL), and
/// records in lines (COLMAP).

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
#include "core/io/colmap_byte_reader.h"
#include "core/io/colmap_index.h"
#include "core/io/input_file.h"
#include "core/io/printable.h"

namespace bundle {

inline bool IsSpace(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

/// Reads a text of white-space separated numbers, of any size, in a buffer of fixed size.
///
/// Made for speed: the common case is one std::from_chars on the buffer. A refused number remains
/// under the cursor, so that Fail() can show it.
class TextCursor {
 public:
  /// `on_block` is called between blocks of about a megabyte; it may throw to end the reading.
  /// `line` is the number of the line where the text begins.
  TextCursor(InputFile& file, std::function<void()> on_block, int64_t line = 1)
      : file_(file), on_block_(std::move(on_block)), buffer_(kReadBlockSize), line_(line) {
    position_ = end_ = buffer_.data();
  }

  /// Reads a number of type T that fills its token and satisfies `accept(value)`; otherwise returns
  /// false and stays before the token.
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

  /// Skips white space. True if the text ends there.
  bool AtEnd() {
    SkipSpace();
    return position_ == end_;
  }

  /// The next token, which stays under the cursor; empty at the end of the text.
  std::string Peek() {
    SkipSpace();
    return std::string(Token());
  }

  /// Number of the line under the cursor.
  int64_t line() const { return line_; }

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
  static constexpr ptrdiff_t kEnoughAhead = 256;  ///< bytes that hold white space and a number
  static constexpr size_t kLongestNumber = 4096;  ///< a longer token is not a number
  static constexpr size_t kShownBytes = 40;

  void SkipSpace() {
    do {
      for (; position_ < end_; ++position_) {
        if (!IsSpace(*position_)) return;
        line_ += *position_ == '\n';
      }
    } while (Refill());
  }

  /// The cases that Read() does not handle: a leading plus, a number at the end of the buffer.
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

  /// Moves unread bytes to the front of the buffer and reads more after them. Returns false if it
  /// reads no bytes: the file has ended or the buffer is full.
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
  int64_t line_;
  bool at_end_ = false;
};

/// Reads a text file of COLMAP record by record and, within a line, token by token, with COLMAP's
/// rules: tokens are separated by white space; blank lines and lines that begin with '#' separate
/// records. Only the line under the cursor is in memory. Throws InputError with the line for
/// unexpected contents.
class ColmapTextCursor {
 public:
  explicit ColmapTextCursor(const ModelFile& file);

  /// Moves to the next line that is neither blank nor a comment; false at the end of the file.
  bool NextRecord();

  /// Moves to the next line, with any contents; false at the end of the file.
  bool NextLine();

  /// Number of the current line, from 1.
  uint64_t line() const { return line_; }

  /// Bytes of the file before the cursor.
  uint64_t offset() const { return line_at_ + static_cast<uint64_t>(cursor_ - begin_); }

  /// Bytes of the file before the next token of the line.
  uint64_t NextTokenOffset() {
    AtEndOfLine();
    return offset();
  }

  /// True if only white space is left in the line.
  bool AtEndOfLine();

  /// Reads the next token. `what` describes it, such as "a camera model", for the message of the
  /// error if the line has no further token. Tokens are valid until the next line.
  std::string_view Token(const char* what);

  /// Reads a whole number from 0 to `max`.
  uint64_t Integer(const char* what, uint64_t max);

  /// Reads a whole number of 64 bits, which may be negative.
  int64_t SignedInteger(const char* what);

  /// Reads a camera, image, rig, frame or sensor id.
  uint32_t Id(const char* what);

  /// Reads a finite number.
  double Number(const char* what);

  /// Reads a pose, qw qx qy qz tx ty tz, and returns its span. `subject` is, for example, "image
  /// 3".
  ColmapSpan Pose(const std::string& subject, double* pose);

  /// Reads the remaining line without white space around it; not empty.
  std::string_view Rest(const char* what);

  void ExpectEndOfLine();

  [[noreturn]] void Fail(const std::string& message) const { file_.Fail(line_, message); }

 private:
  static constexpr size_t kLongestLine = size_t{1} << 30;

  /// Returns false, with the cursor still before the token, if it is not a whole number up to
  /// `max`.
  template <typename T>
  bool ParseInteger(const char* what, T max, T* value);

  /// Fails with a message about the token that begins at the cursor.
  [[noreturn]] void FailHere(const std::string& expected);

  const ModelFile& file_;
  FileWindow window_;
  uint64_t line_at_ = 0;    ///< position of the line in the file
  uint64_t next_line_ = 0;  ///< position of the next line
  const char* begin_ = nullptr;
  const char* cursor_ = nullptr;
  const char* end_of_line_ = nullptr;
  uint64_t line_ = 0;
};

}  // namespace bundle
