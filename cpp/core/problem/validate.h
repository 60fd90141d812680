#pragma once

#include "core/problem/problem_view.h"

namespace bundle {

/// Checks the values of a problem whose arrays have the right sizes.
///
/// Throws InputError at the first value that is not finite, index out of range, repeated id, zero
/// quaternion, non-positive focal length or parameter row that is too short, naming what has it by
/// its id. Camera models that are not known (nullptr) are let through: whoever needs the model says
/// so.
void ValidateProblem(const ProblemView& problem);

}  // namespace bundle
