#pragma once

#include "core/fused/minimize/least_squares.h"

namespace bundle::fused {

/// The step d = p * (gradient direction) + q * (Newton direction).
struct Combination {
  double p = 0, q = 0;
  double length = 0;  ///< ||D d||
};

/// On the path from x to the minimum of the model along the gradient and on to the Newton step:
/// its end, or where it leaves the radius.
Combination TraditionalDogleg(const DirectionProducts& products, double radius);

/// The minimum of the model among all combinations within the radius.
Combination SubspaceDogleg(const DirectionProducts& products, double radius);

}  // namespace bundle::fused
