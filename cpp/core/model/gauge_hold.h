#pragma once

/// Pose numbers that are held constant to fix the gauge (gauge_hold.cpp).

#include <string>

#include "core/interface/adjustment_problem.h"
#include "core/model/free_parameters.h"

namespace bundle {

/// Removes as many pose numbers from `free` as there are motions that change no image
/// (gauge_count.h), so that no such motion remains. Returns a message if a motion remains that
/// no free number can fix. Returns "" otherwise, and also if no pose is free.
std::string HoldFreeMotions(const AdjustmentProblem& problem, FreeParameters* free);

}  // namespace bundle
