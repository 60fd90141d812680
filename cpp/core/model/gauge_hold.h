#pragma once

/// Numbers of poses that hold the free motions of the world (gauge_hold.cpp).

#include <string>

#include "core/interface/adjustment_problem.h"
#include "core/model/free_parameters.h"

namespace bundle {

/// Removes as many numbers of poses from `free` as there are motions that change no image
/// (gauge_count.h), so that no such motion is left. Returns a sentence if some are left, because no
/// free number moves by them; "" also if no pose is free.
std::string HoldFreeMotions(const AdjustmentProblem& problem, FreeParameters* free);

}  // namespace bundle
