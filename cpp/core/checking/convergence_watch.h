#pragma once

/// Test of the iterations of a solve for signs of a wrong Jacobian (derived in
/// convergence_watch.cpp).

#include <string>
#include <vector>

#include "core/interface/summary.h"

namespace bundle {

/// Tests the iterations for the signature of a wrong Jacobian. Returns a message with the finding,
/// which ends with `advice`; "" without a finding.
std::string WatchConvergence(const std::vector<IterationRecord>& iterations,
                             const std::string& advice = "test it with `bundle check`");

}  // namespace bundle
