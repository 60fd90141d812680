#pragma once

/// Sums as double-doubles: a sum and its error term, with about twice the digits of a double.
///
/// The rounding error of a + b is itself a double, and six additions compute it (D. E. Knuth, The
/// Art of Computer Programming 2, 4.2.2, theorem B). Let s be a sum in doubles and e the total of
/// its rounding errors. Then s + e is the sum as if computed with 106 bits (T. Ogita, S. M. Rump,
/// S. Oishi: Accurate Sum and Dot Product, SIAM J. Sci. Comput. 26, 2005, Sum2). Another order of
/// the terms changes s + e by 2^-106 times the size of the terms. The value of s + e rounded to a
/// double is then the same in any order, except if s + e is within this distance of the midpoint of
/// two doubles: one sum in about 10^15.
///
/// The error term of a sum that is not finite is undefined.

#include <cmath>

namespace bundle {

/// Adds a value to sum + error.
inline void AddDoubleDouble(double value, double* sum, double* error) {
  const double before = *sum, after = before + value;
  const double added = after - before;
  *error += (before - (after - added)) + (value - added);
  *sum = after;
}

/// sum + error, rounded to a double.
inline double RoundDoubleDouble(double sum, double error) {
  return std::isfinite(sum) ? sum + error : sum;
}

/// A sum and its error term.
struct DoubleDouble {
  double sum = 0, error = 0;

  void Add(double value) { AddDoubleDouble(value, &sum, &error); }
  void Add(const DoubleDouble& other) {
    Add(other.sum);
    error += other.error;
  }
  double Rounded() const { return RoundDoubleDouble(sum, error); }
};

}  // namespace bundle
