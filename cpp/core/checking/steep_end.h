#pragma once

/// Test for a solve that ended on a slope (derived in steep_end.cpp).

#include <string>

#include "core/interface/summary.h"

namespace bundle {

/// One sentence about a solve that ended by parameter tolerance or radius where its model still
/// predicts a decrease (steep_end.cpp); "" about any other.
std::string FindSteepEnd(const SolveRecord& record, double function_tolerance);

}  // namespace bundle
