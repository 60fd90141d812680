#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/io/model_file.h"

namespace bundle {

/// Walks through a text file of COLMAP record by record and, within a line, token by token, with
/// COLMAP's rules: tokens are separated by white space; blank lines and lines that begin with '#'
/// stand between records. Everything that is not as asked for throws InputError with the line.
class ColmapTextCursor {
 public:
  explicit ColmapTextCursor(const ModelFile& file);

  /// Goes to the next line that is neither blank nor a comment; false at the end of the file.
  bool NextRecord();

  /// Goes to the next line, whatever is in it; false at the end of the file.
  bool NextLine();

  /// Number of the current line, from 1.
  uint64_t line() const { return line_; }

  /// Bytes of the file before the cursor.
  uint64_t offset() const { return static_cast<uint64_t>(cursor_ - file_.contents().data()); }

  /// Bytes of the file before the next token of the line.
  uint64_t NextTokenOffset() {
    AtEndOfLine();
    return offset();
  }

  /// Bytes of the file not yet gone through.
  size_t num_left() const { return static_cast<size_t>(end_ - next_line_); }

  /// True when nothing but white space is left of the line.
  bool AtEndOfLine();

  /// The next token. `what` says what was expected if there is none: "a camera model".
  std::string_view Token(const char* what);

  /// A whole number from 0 to `max`.
  uint64_t Integer(const char* what, uint64_t max);

  /// A whole number that may be negative, of 64 bits.
  int64_t SignedInteger(const char* what);

  /// A camera, image, rig, frame or sensor id.
  uint32_t Id(const char* what);

  /// A finite number.
  double Number(const char* what);

  /// The rest of the line without white space around it; not empty.
  std::string_view Rest(const char* what);

  void ExpectEndOfLine();

  [[noreturn]] void Fail(const std::string& message) const { file_.Fail(line_, message); }

 private:
  /// False, with the cursor still before the token, if that is no whole number up to `max`.
  template <typename T>
  bool ParseInteger(const char* what, T max, T* value);

  /// Fails over the token that begins at the cursor.
  [[noreturn]] void FailHere(const std::string& expected);

  const ModelFile& file_;
  const char* next_line_;
  const char* end_;
  const char* cursor_ = nullptr;
  const char* end_of_line_ = nullptr;
  uint64_t line_ = 0;
};

}  // namespace bundle
