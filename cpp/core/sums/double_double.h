#pragma once

/// Sums with twice the digits of a double, of which the first half hardly depends on the order.
///
/// What rounding takes from a + b is a double itself, and six additions find it (D. E. Knuth, The
/// Art of Computer Programming 2, 4.2.2, theorem B). A sum s that keeps the total e of all it has
/// lost is s + e as if it had been added up in 106 bits (T. Ogita, S. M. Rump, S. Oishi: Accurate
/// Sum and Dot Product, SIAM J. Sci. Comput. 26, 2005, Sum2): in another order s + e differs by
/// 2^-106 of what was added. Rounded to a double it is the same unless it lies that close to the
/// middle of two, one sum in 10^15 or so.
///
/// A sum that is not finite has no e.

#include <cmath>

namespace bundle {

/// Adds a value to sum + rest.
inline void AddTwofold(double value, double* sum, double* rest) {
  const double before = *sum, after = before + value;
  const double added = after - before;
  *rest += (before - (after - added)) + (value - added);
  *sum = after;
}

/// sum + rest, as a double.
inline double RoundTwofold(double sum, double rest) {
  return std::isfinite(sum) ? sum + rest : sum;
}

struct TwofoldSum {
  double sum = 0, rest = 0;

  void Add(double value) { AddTwofold(value, &sum, &rest); }
  void Add(const TwofoldSum& other) {
    Add(other.sum);
    rest += other.rest;
  }
  double Rounded() const { return RoundTwofold(sum, rest); }
};

}  // namespace bundle
