#pragma once

/// Test for a wrong Jacobian by the iterations of a solve (derived in convergence_watch.cpp).

#include <string>
#include <vector>

#include "core/interface/summary.h"

namespace bundle {

/// Looks for the signature of a wrong Jacobian in the iterations (convergence_watch.cpp). One
/// sentence that says what was seen and ends with `advice`, what finds the mistake; "" if nothing
/// was.
std::string WatchConvergence(const std::vector<IterationRecord>& iterations,
                             const std::string& advice = "`bundle check` finds out");

}  // namespace bundle
