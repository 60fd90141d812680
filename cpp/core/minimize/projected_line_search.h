#pragma once

/// Line search along a step that is projected onto bounds (derived in projected_line_search.cpp).

#include "core/minimize/least_squares.h"

namespace bundle {

/// Shortens a step whose projection onto the bounds does not lower the cost enough.
///
/// `cost` is the cost at x, held cost included. `candidate` is the candidate of the full step. If a
/// shorter step was found, `candidate` becomes the candidate of that step, with the model cost
/// change of the full step. The candidate of `problem` is then the same.
void SearchAlongStep(double cost, LeastSquares* problem, Candidate* candidate);

}  // namespace bundle
