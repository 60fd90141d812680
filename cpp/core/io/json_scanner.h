#pragma once

/// Events of a JSON file of any size, by RapidJSON's streaming parser.

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "core/error.h"
#include "core/io/input_file.h"

namespace bundle {

/// Position in a JSON file, for messages.
class JsonPosition {
 public:
  virtual ~JsonPosition() = default;

  /// `NAME:LINE` of the file.
  virtual std::string Where() const = 0;

  /// Throws the InputError `NAME:LINE: PLACE expected EXPECTED, found FOUND`. `place`: members that
  /// lead to the value, such as "points: 7: "; may be empty.
  [[noreturn]] void Fail(const std::string& place, const std::string& expected,
                         const std::string& found) const {
    throw InputError(Where() + ": " + place + "expected " + expected + ", found " + found);
  }
};

/// Receiver of the values of a JSON file in the order of the file.
class JsonEvents {
 public:
  virtual ~JsonEvents() = default;
  /// A number as it is in the file; also NaN and Infinity, which Python writes.
  virtual void Number(std::string_view text) = 0;
  virtual void String(std::string_view text) = 0;
  /// true, false or null.
  virtual void Literal(std::string_view word) = 0;
  virtual void Key(std::string_view name) = 0;
  /// `bracket` is '{' or '['.
  virtual void Begin(char bracket) = 0;
  virtual void End(char bracket) = 0;
};

/// Passes the values of a file to `events(position)`.
///
/// @param on_block called between blocks of about a megabyte; may throw to end the reading.
/// Throws InputError with the line for contents that are not JSON.
void ScanJson(InputFile& file, const std::function<void()>& on_block,
              const std::function<JsonEvents&(const JsonPosition&)>& events);

}  // namespace bundle
