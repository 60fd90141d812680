#pragma once

#include <string>

#include "core/problem/problem_view.h"
#include "core/solve/free_parameters.h"
#include "core/solve/options.h"

namespace bundle {

/// Takes the seven degrees of freedom that no observation sees (rotation, translation, scale of the
/// world) out of `free`, unless two images or three points that are fixed already hold them.
/// Returns a sentence, to be shown to the user, where that could not be done as asked; else "".
std::string FixGauge(const ProblemView& problem, Gauge gauge, FreeParameters* free);

}  // namespace bundle
