#pragma once

/// Test for a solve that ended on a slope (derived in steep_end.cpp).

#include <string>

#include "core/interface/summary.h"

namespace bundle {

/// Returns a message if a solve ended by parameter tolerance or radius although its model still
/// predicts a decrease; otherwise "".
std::string FindSteepEnd(const SolveRecord& record, double function_tolerance);

}  // namespace bundle
