#pragma once

#include <cctype>
#include <cstddef>
#include <string>

#include "core/solve/options.h"

namespace bundle {

/// An option's value as users write it: "dense_schur".
template <typename Enum, size_t kSize>
std::string NameOf(Enum value, const NamedValue<Enum> (&names)[kSize]) {
  for (const auto& [name, named] : names) {
    if (named == value) return std::string(name);
  }
  return "";
}

/// As summaries and Ceres write it: "DENSE_SCHUR".
template <typename Enum, size_t kSize>
std::string UpperName(Enum value, const NamedValue<Enum> (&names)[kSize]) {
  std::string name = NameOf(value, names);
  for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return name;
}

}  // namespace bundle
