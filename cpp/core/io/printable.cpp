#include "core/io/printable.h"

#include <cstddef>
#include <cstdint>

namespace bundle {

namespace {

/// Length of the valid, printable UTF-8 sequence at the start of `bytes`; 0 if there is none.
size_t PrintableLength(std::string_view bytes) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>(bytes[i]); };
  const uint8_t lead = byte(0);
  if (lead < 0x80) return lead >= 0x20 && lead != 0x7f ? 1 : 0;
  const size_t length = lead >= 0xf0 ? 4 : lead >= 0xe0 ? 3 : 2;
  if (lead < 0xc2 || lead > 0xf4 || bytes.size() < length) return 0;
  uint32_t code = lead & (0x7fu >> length);
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0) != 0x80) return 0;
    code = code << 6 | (byte(i) & 0x3fu);
  }
  const bool overlong = (length == 3 && code < 0x800) || (length == 4 && code < 0x10000);
  const bool surrogate = code >= 0xd800 && code <= 0xdfff;
  const bool breaks_line = code < 0xa0 || code == 0x2028 || code == 0x2029;
  return overlong || surrogate || breaks_line || code > 0x10ffff ? 0 : length;
}

}  // namespace

std::string Printable(std::string_view bytes, size_t max_bytes) {
  constexpr char kHex[] = "0123456789abcdef";
  std::string text;
  size_t position = 0;
  while (position < bytes.size() && position < max_bytes) {
    const size_t length = PrintableLength(bytes.substr(position));
    if (length > 0) {
      text.append(bytes.substr(position, length));
      position += length;
    } else {
      const auto byte = static_cast<uint8_t>(bytes[position++]);
      text += {'\\', 'x', kHex[byte >> 4], kHex[byte & 15]};
    }
  }
  if (position < bytes.size()) text += "...";
  return text;
}

std::string Quoted(std::string_view text) {
  // Appended piece by piece: for a chain of operator+, GCC 12 gives a false warning (-Wrestrict).
  constexpr size_t kMaxQuotedLength = 40;
  std::string result = "'";
  result += Printable(text, kMaxQuotedLength);
  result += "'";
  return result;
}

}  // namespace bundle
