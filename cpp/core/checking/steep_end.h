#pragma once

/// Test for a solve that ended on a slope (derived in steep_end.cpp).

#include <string>

#include "core/interface/summary.h"

namespace bundle {

/// Returns one sentence if a solve ended by parameter tolerance or radius although its model still
/// predicts a decrease; else "".
std::string FindSteepEnd(const SolveRecord& record, double function_tolerance);

}  // namespace bundle
