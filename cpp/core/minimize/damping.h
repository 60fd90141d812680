#pragma once

/// Scale s and damping D^2 of a column of the Jacobian with the squared norm c (least_squares.h).

#include <algorithm>
#include <cmath>

namespace bundle {

/// Ceres' min_lm_diagonal and max_lm_diagonal.
inline constexpr double kMinDiagonal = 1e-6, kMaxDiagonal = 1e32;

inline double JacobiScale(double squared_norm) { return 1 / (1 + std::sqrt(squared_norm)); }

inline double SquaredDamping(double squared_norm, double scale) {
  const double squared_scale = scale * scale;
  return std::clamp(squared_scale * squared_norm, kMinDiagonal, kMaxDiagonal) / squared_scale;
}

}  // namespace bundle
