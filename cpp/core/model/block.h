#pragma once

/// A variable of a problem.

#include <string>
#include <vector>

#include "core/model/retraction.h"

namespace bundle {

struct Block {
  std::string name;  ///< for messages
  Retraction retraction;
  std::vector<double> value;  ///< where the chart starts, as the manifold stores it
  /// One entry a tangent coordinate, true where it stays; empty: all are free.
  std::vector<bool> held;
  /// Of Euclidean values, one entry a number, infinite where there is none; empty: none at all.
  std::vector<double> lower;
  std::vector<double> upper;

  bool IsHeld(int coordinate) const { return !held.empty() && held[coordinate]; }

  int NumFree() const {
    int count = 0;
    for (int i = 0; i < retraction.tangent_size(); ++i) count += IsHeld(i) ? 0 : 1;
    return count;
  }
};

}  // namespace bundle
