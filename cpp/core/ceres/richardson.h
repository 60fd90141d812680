#pragma once

/// Derivatives by central differences with Richardson extrapolation, and how far to trust them.
///
/// With D(h) = (f(h) - f(-h)) / 2h = f' + c2 h^2 + c4 h^4 + ..., halving h and combining removes
/// one power of h^2 after the other:
///
///   T(k, 0) = D(h0 / 2^k),     T(k, m) = T(k, m-1) + (T(k, m-1) - T(k-1, m-1)) / (4^m - 1).
///
/// The difference of T(k, m) to its two parents estimates its error, truncation and rounding alike;
/// the entry with the least estimate wins (Ridders, "Accurate computation of F'(x) and
/// F'(x)F''(x)", 1982). Ceres stops its tableau by an absolute threshold and drops the estimate;
/// here the step shrinks on, by orders of magnitude where the function asks for it (a point close
/// to the camera, a parameter near a singularity), until the estimate is small beside the
/// derivative, and the estimate is returned, so that a comparison can subtract what the reference
/// does not know.

#include <functional>

namespace bundle {

/// f(step, values): num_values values at `step` along a line; false where there is no value.
using LineFunction = std::function<bool(double step, double* values)>;

/// The derivative of each value at step 0 and a bound on its error that is infinite where no
/// derivative was found. `first_step` > 0 is where the search begins, `noise` the size of the
/// rounding errors of each value.
void RichardsonDerivative(const LineFunction& f, int num_values, double first_step,
                          const double* noise, double* derivative, double* uncertainty);

}  // namespace bundle
