#pragma once

/// A(q) = atan(t) / t as a function of q = t^2, and its derivative A' = dA/dq.
///
///   A' = (1 / (1 + q) - A) / (2 q).
///
/// The difference loses log10(1 / q) digits for small q, and both are 0 / 0 at q = 0. Below q =
/// 0.01 the series
///
///   A = sum_k (-q)^k / (2k + 1),        A' = -sum_k (-q)^k (k + 1) / (2k + 3)
///
/// has converged to the last bit after nine terms.

#include <cmath>

namespace bundle {

struct ArctanRatio {
  double value, slope;

  explicit ArctanRatio(double q) {
    if (q < 0.01) {
      constexpr int kLast = 8;
      value = 1.0 / (2 * kLast + 1);
      slope = (kLast + 1.0) / (2 * kLast + 3);
      for (int k = kLast - 1; k >= 0; --k) {
        value = 1.0 / (2 * k + 1) - q * value;
        slope = (k + 1.0) / (2 * k + 3) - q * slope;
      }
      slope = -slope;
    } else {
      const double t = std::sqrt(q);
      value = std::atan(t) / t;
      slope = (1 / (1 + q) - value) / (2 * q);
    }
  }
};

}  // namespace bundle
