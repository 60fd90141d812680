#pragma once

/// Values that the fused backend does not support, for the choice of a backend.

#include <optional>
#include <string>

#include "core/interface/options.h"
#include "core/prepare/prepare.h"

namespace bundle {

/// An option value that the fused backend does not support.
struct Unsupported {
  std::string option;
  std::string expected;
  std::string found;
};

/// The first such value of the options alone, or of the options and a problem.
std::optional<Unsupported> FindUnsupported(const SolveOptions& options);
std::optional<Unsupported> FindUnsupported(const SolveOptions& options,
                                           const PreparedSolve& prepared);

}  // namespace bundle
