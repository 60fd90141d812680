#pragma once

/// Bytes of files and of their names, made printable for messages.

#include <cstddef>
#include <string>
#include <string_view>

namespace bundle {

/// Bytes of a file or of its name, fit for one line of a message: valid UTF-8 is kept; control
/// characters, line separators and bytes that are no UTF-8 become \xNN; after `max_bytes` input
/// bytes there is "...".
std::string Printable(std::string_view bytes, size_t max_bytes = std::string_view::npos);

/// The text in quotes, printable and shortened for a message.
std::string Quoted(std::string_view text);

}  // namespace bundle
