#pragma once

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/model/retraction.h"

namespace bundle {

/// The value as the manifold stores it, quaternions of norm 1. Throws InputError, beginning with
/// `subject`, if it has another size, is not finite, or its quaternion is zero.
inline std::vector<double> CheckedValue(const std::string& subject, const Retraction& retraction,
                                        std::vector<double> value) {
  if (static_cast<int>(value.size()) != retraction.ambient_size()) {
    throw InputError(subject + ": expected " + std::to_string(retraction.ambient_size()) +
                     " numbers (" + retraction.name() + "), found " + std::to_string(value.size()));
  }
  for (size_t i = 0; i < value.size(); ++i) {
    if (std::isfinite(value[i])) continue;
    throw InputError(subject + ": expected finite numbers, found " + std::to_string(value[i]) +
                     " at [" + std::to_string(i) + "]");
  }
  if (!retraction.Normalize(value.data())) {
    throw InputError(subject + ": expected a quaternion (qx qy qz qw), found one of norm 0");
  }
  return value;
}

}  // namespace bundle
