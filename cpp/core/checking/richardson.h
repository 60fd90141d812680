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
///
/// A bound from one range of steps holds only where f is smooth on that range. Close to a pole, say
/// 1 / (x + d) with steps h far above d, D(h) = 1 / (h^2 - d^2) looks as if it converged to zero.
/// So settled values are compared with D at steps that are smaller by powers of 64:
///
/// - if they agree up to rounding errors, the bound is kept;
/// - if finer steps settle on another value, that is the derivative;
/// - if they do not settle, the bound grows by the disagreement.
///
/// A kink at the point itself leaves D(h) smooth. It shows in the half difference of the slopes on
/// both sides, s(h) = |f(h) - 2 f(0) + f(-h)| / 2h, which falls with h for a smooth f and is
/// constant at a kink. There any number within s of D is a slope of f, and the bound is at least s.

#include <functional>

namespace bundle {

/// f(step, values): num_values values at `step` along a line; false where there is no value.
using LineFunction = std::function<bool(double step, double* values)>;

/// The derivative of each value at step 0 and a bound on its error that is infinite where no
/// derivative was found. `first_step` > 0 is where the search begins, `noise` the size of the
/// rounding errors of each value.
void RichardsonDerivative(const LineFunction& f, int num_values, double first_step,
                          const double* noise, double* derivative, double* uncertainty);

/// Raises the noise of each value to that of its sixth differences at multiples of `step`. For a
/// smooth f, these contain only its rounding errors, each of which enters with a variance of 924 =
/// sum_k binomial(6, k)^2 (J. J. More, S. M. Wild: Estimating computational noise, SIAM J. Sci.
/// Comput. 33, 2011). The step is far above the resolution of the parameters and far below their
/// scale.
void RaiseToScatter(const LineFunction& f, int num_values, double step, double* noise);

}  // namespace bundle
