#include "core/io/colmap_text_cursor.h"

#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <locale>
#include <sstream>

#include "core/io/colmap_index.h"

namespace bundle {
namespace {

bool IsSpace(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

/// What COLMAP strips from both ends of a line.
bool IsTrimmed(char c) { return c == ' ' || c == '\t' || c == '\r'; }

/// std::from_chars takes no plus sign, the streams that COLMAP reads with do.
const char* SkipPlus(const char* begin, const char* end) {
  const bool has_plus = end - begin > 1 && *begin == '+' && begin[1] != '-' && begin[1] != '+';
  return has_plus ? begin + 1 : begin;
}

}  // namespace

ColmapTextCursor::ColmapTextCursor(const ModelFile& file)
    : file_(file),
      next_line_(file.contents().data()),
      end_(file.contents().data() + file.contents().size()) {}

bool ColmapTextCursor::NextRecord() {
  while (NextLine()) {
    if (cursor_ != end_of_line_ && *cursor_ != '#') return true;
  }
  return false;
}

bool ColmapTextCursor::NextLine() {
  if (next_line_ == end_) return false;
  const void* newline = std::memchr(next_line_, '\n', static_cast<size_t>(end_ - next_line_));
  cursor_ = next_line_;
  end_of_line_ = newline == nullptr ? end_ : static_cast<const char*>(newline);
  next_line_ = newline == nullptr ? end_ : end_of_line_ + 1;
  while (cursor_ != end_of_line_ && IsTrimmed(*cursor_)) ++cursor_;
  while (cursor_ != end_of_line_ && IsTrimmed(end_of_line_[-1])) --end_of_line_;
  ++line_;
  return true;
}

bool ColmapTextCursor::AtEndOfLine() {
  while (cursor_ != end_of_line_ && IsSpace(*cursor_)) ++cursor_;
  return cursor_ == end_of_line_;
}

std::string_view ColmapTextCursor::Token(const char* what) {
  if (AtEndOfLine()) Fail(std::string("expected ") + what + ", found the end of the line");
  const char* begin = cursor_;
  while (cursor_ != end_of_line_ && !IsSpace(*cursor_)) ++cursor_;
  return {begin, static_cast<size_t>(cursor_ - begin)};
}

template <typename T>
bool ColmapTextCursor::ParseInteger(const char* what, T max, T* value) {
  if (AtEndOfLine()) Token(what);
  const auto [end, error] = std::from_chars(SkipPlus(cursor_, end_of_line_), end_of_line_, *value);
  if (error != std::errc() || *value > max || (end != end_of_line_ && !IsSpace(*end))) return false;
  cursor_ = end;
  return true;
}

uint64_t ColmapTextCursor::Integer(const char* what, uint64_t max) {
  uint64_t value = 0;
  if (!ParseInteger(what, max, &value)) {
    FailHere(std::string(what) + " (a whole number from 0 to " + std::to_string(max) + ")");
  }
  return value;
}

int64_t ColmapTextCursor::SignedInteger(const char* what) {
  int64_t value = 0;
  if (!ParseInteger(what, std::numeric_limits<int64_t>::max(), &value)) {
    FailHere(std::string(what) + " (a whole number below 2^63)");
  }
  return value;
}

uint32_t ColmapTextCursor::Id(const char* what) {
  return static_cast<uint32_t>(Integer(what, kInvalidColmapId - 1));
}

double ColmapTextCursor::Number(const char* what) {
  if (AtEndOfLine()) Token(what);
  double value = 0.0;
  const char* begin = SkipPlus(cursor_, end_of_line_);
  const auto [end, error] = std::from_chars(begin, end_of_line_, value);
  if (error == std::errc::result_out_of_range) {
    // Too large or too close to zero: from_chars does not say which, COLMAP takes the latter.
    std::istringstream stream(std::string(begin, end));
    stream.imbue(std::locale::classic());
    if (!(stream >> value)) value = std::numeric_limits<double>::infinity();
  } else if (error != std::errc()) {
    FailHere(std::string(what) + " (a finite number)");
  }
  if (!std::isfinite(value) || (end != end_of_line_ && !IsSpace(*end))) {
    FailHere(std::string(what) + " (a finite number)");
  }
  cursor_ = end;
  return value;
}

std::string_view ColmapTextCursor::Rest(const char* what) {
  if (AtEndOfLine()) Token(what);
  const std::string_view rest(cursor_, static_cast<size_t>(end_of_line_ - cursor_));
  cursor_ = end_of_line_;
  return rest;
}

void ColmapTextCursor::ExpectEndOfLine() {
  if (!AtEndOfLine()) FailHere("the end of the line");
}

void ColmapTextCursor::FailHere(const std::string& expected) {
  Fail("expected " + expected + ", found " + Quoted(Token("")));
}

}  // namespace bundle
