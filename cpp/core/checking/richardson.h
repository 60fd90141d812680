#pragma once

/// Derivatives by central differences with Richardson extrapolation, and bounds on their errors.
///
/// With D(h) = (f(h) - f(-h)) / 2h = f' + c2 h^2 + c4 h^4 + ..., halving h and combining removes
/// one power of h^2 after the other:
///
///   T(k, 0) = D(h0 / 2^k),     T(k, m) = T(k, m-1) + (T(k, m-1) - T(k-1, m-1)) / (4^m - 1).
///
/// The difference of T(k, m) to its two parents estimates its error, both truncation and rounding.
/// The entry with the least estimate is used (Ridders, "Accurate computation of F'(x) and
/// F'(x)F''(x)", 1982). Ceres stops its tableau by an absolute threshold and drops the estimate.
/// Here the step shrinks further, by orders of magnitude if necessary (a point close to the camera,
/// a parameter near a singularity), until the estimate is small relative to the derivative. The
/// estimate is returned, so that a comparison can subtract the uncertainty of the reference.
///
/// A bound from one range of steps is valid only if f is smooth on that range. Close to a pole, for
/// instance 1 / (x + d) with steps h far above d, D(h) = 1 / (h^2 - d^2) seems to converge to zero.
/// So settled values are compared with D at steps that are smaller by powers of 64:
///
/// - if they agree up to rounding errors, the bound is kept;
/// - if finer steps settle on another value, that is the derivative;
/// - if they do not settle, the bound grows by the disagreement.
///
/// At a kink at the point itself, D(h) stays smooth. The kink is visible in half the difference of
/// the slopes on both sides, s(h) = |f(h) - 2 f(0) + f(-h)| / 2h. It decreases with h for a smooth
/// f and is constant at a kink. There, any number within s of D is a slope of f, and the bound is
/// at least s.

#include <functional>

namespace bundle {

/// f(step, values): num_values values at `step` along a line; returns false if there is no value.
using LineFunction = std::function<bool(double step, double* values)>;

/// The derivative of each value at step 0 and a bound on its error, which is infinite if no
/// derivative was found. The search begins at `first_step` > 0. `noise` is the size of the rounding
/// errors of each value.
void RichardsonDerivative(const LineFunction& f, int num_values, double first_step,
                          const double* noise, double* derivative, double* uncertainty);

/// Raises the noise of each value to that of its sixth differences at multiples of `step`. For a
/// smooth f, these contain only its rounding errors, each of which enters with a variance of 924 =
/// sum_k binomial(6, k)^2 (J. J. More, S. M. Wild: Estimating computational noise, SIAM J. Sci.
/// Comput. 33, 2011). The step is far above the resolution of the parameters and far below their
/// scale.
void RaiseToScatter(const LineFunction& f, int num_values, double step, double* noise);

}  // namespace bundle
