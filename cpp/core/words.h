#pragma once

/// Counts in messages: "1 residual", "2 residuals".

#include <cstdint>
#include <string>

namespace bundle {

inline std::string Counted(int64_t count, const std::string& noun) {
  return std::to_string(count) + " " + noun + (count == 1 ? "" : "s");
}

}  // namespace bundle
