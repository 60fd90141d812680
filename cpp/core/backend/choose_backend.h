#pragma once

#include <string>

#include "core/solve/options.h"
#include "core/solve/prepare.h"

namespace bundle {

struct BackendChoice {
  Backend backend = Backend::kCeres;  ///< not kAuto
  std::string reason;                 ///< one sentence; "" where the backend was asked for
};

/// Chooses the backend: the fused one for what it supports, unless another was asked for.
///
/// Throws InputError if the fused backend was asked for what it does not support; the message names
/// the option.
BackendChoice ChooseBackend(const SolveOptions& options, const PreparedSolve& prepared);

}  // namespace bundle
