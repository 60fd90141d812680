#pragma once

/// Numbers of poses that hold the free motions of the world (gauge_hold.cpp).

#include <string>

#include "core/interface/adjustment_problem.h"
#include "core/model/free_parameters.h"

namespace bundle {

/// Takes as many numbers of poses out of `free` as there are motions that change no image
/// (gauge_count.h), none of which is left then. Returns a sentence if some are, as nothing that is
/// free moves by them; "" also where no pose is free at all.
std::string HoldFreeMotions(const AdjustmentProblem& problem, FreeParameters* free);

}  // namespace bundle
