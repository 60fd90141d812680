#pragma once

/// The strategy of a trust region method for the options of a solve.

#include <memory>

#include "core/interface/options.h"
#include "core/minimize/strategy.h"

namespace bundle {

/// Throws InputError if the options name no strategy.
std::unique_ptr<Strategy> MakeStrategy(const SolveOptions& options);

}  // namespace bundle
