#pragma once

#include "core/minimize/least_squares.h"

namespace bundle::fused {

/// Shortens a step whose projection onto the bounds does not lower the cost enough. `cost`: at x.
/// `candidate` is that of the whole step; where a shorter one was found it becomes that one's, with
/// the model cost change of the whole step. The candidate of `problem` follows.
void SearchAlongStep(double cost, LeastSquares* problem, Candidate* candidate);

}  // namespace bundle::fused
