#pragma once

/// Resolution of values along a line: those that lose their last digits, in a sum with a large
/// constant or in single precision, stand still over small steps and then change in jumps.
///
/// Values are compared at steps that grow by factors of 64. A value that stands still at a step and
/// changes at the next by far more than its noise has the resolution of this change, at most 64
/// times too much. It may also be a feature, as the border of a robust loss or of a clamp. The
/// changes at several parts of the step decide: of jumps q, all are multiples of one.

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

namespace bundle {

/// f(step, values): num_values values at `step` along a line; returns false if there is no value.
using LineFunction = std::function<bool(double step, double* values)>;

struct Resolution {
  std::vector<double> jump;       ///< change after standing still; 0: none
  std::vector<char> stood_still;  ///< 1 if the value is the same at some step
};

namespace resolution_internal {

inline constexpr int kFiner = 5;         ///< number of steps below the largest
inline constexpr double kRatio = 64;     ///< ratio of consecutive steps
inline constexpr double kExplained = 8;  ///< change that is rounding, in units of the noise

/// The number of which both are multiples, to rounding errors of `rounding`.
inline double CommonDivisor(double a, double b, double rounding) {
  while (b > rounding) {
    const double left = std::abs(std::remainder(a, b));
    a = b;
    b = left;
  }
  return a;
}

/// 1 for each value whose changes from `center` at parts of a step are small multiples of one.
inline std::vector<char> AreStairs(const LineFunction& f, const std::vector<double>& center,
                                   double step) {
  constexpr double kParts[] = {1, 0.97, 0.9, 0.8, 0.6, 0.4};
  constexpr double kRounding = 1e-6, kMost = 2 * kRatio;
  const size_t n = center.size();
  std::vector<double> largest(n, 0), jump(n, 0), values(n);
  for (const double part : kParts) {
    if (!f(part * step, values.data())) return std::vector<char>(n, 0);
    for (size_t i = 0; i < n; ++i) {
      const double change = std::abs(values[i] - center[i]);
      largest[i] = std::max(largest[i], change);
      jump[i] = CommonDivisor(jump[i], change, kRounding * largest[i]);
    }
  }
  std::vector<char> are_stairs(n);
  for (size_t i = 0; i < n; ++i) are_stairs[i] = kMost * jump[i] >= largest[i];
  return are_stairs;
}

}  // namespace resolution_internal

/// `noise`: rounding errors of the values.
inline Resolution FindResolution(const LineFunction& f, int num_values, double largest_step,
                                 const double* noise) {
  using namespace resolution_internal;
  Resolution found{std::vector<double>(num_values, 0), std::vector<char>(num_values, 0)};
  std::vector<char> moves(num_values, 0);
  std::vector<double> center(num_values), values(num_values);
  if (!f(0, center.data())) return found;
  for (int finer = kFiner; finer >= 0; --finer) {
    const double h = largest_step * std::pow(kRatio, -finer);
    if (!f(h, values.data())) return found;
    std::vector<char> jumps(num_values, 0);
    for (int i = 0; i < num_values; ++i) {
      const double change = std::abs(values[i] - center[i]);
      // Change expected from the previous step.
      const bool unexplained = change / kRatio > kExplained * noise[i];
      jumps[i] = found.stood_still[i] && !moves[i] && unexplained;
      (change > 0 ? moves : found.stood_still)[i] = 1;
    }
    if (std::find(jumps.begin(), jumps.end(), 1) != jumps.end()) {
      const std::vector<char> are_stairs = AreStairs(f, center, h);
      for (int i = 0; i < num_values; ++i) jumps[i] &= are_stairs[i];
    }
    for (int i = 0; i < num_values; ++i) {
      if (jumps[i]) found.jump[i] = std::abs(values[i] - center[i]);
    }
    if (std::find(moves.begin(), moves.end(), 0) == moves.end()) return found;
  }
  return found;
}

}  // namespace bundle
