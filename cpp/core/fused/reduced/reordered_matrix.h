#pragma once

#include <cstdint>
#include <vector>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// The lower triangle of S with its blocks in another order: CHOLMOD would permute scalar by
/// scalar, in two passes with indices; by blocks it is one pass over the values.
class ReorderedMatrix {
 public:
  /// order[k]: the block of `from` that becomes the k-th. Keeps a reference to `from`.
  ReorderedMatrix(const ReducedStructure& from, const std::vector<int>& order);

  const ReducedStructure& structure() const { return structure_; }

  /// Values in the order of structure(), valid until the next call. `values` itself where the order
  /// changes nothing. What stands above the diagonal in diagonal blocks has no meaning.
  double* Reorder(std::vector<double>* values, int num_threads);

  /// to[...] = from[...] with the blocks of a vector in the new order, and back.
  void ReorderVector(const double* from, double* to) const;
  void RestoreVector(const double* from, double* to) const;

 private:
  struct Target {
    int64_t begin;  ///< where the block's values go
    int stride;     ///< from one of its columns to the next
    bool transposed;
  };

  void ReorderColumn(int j, const double* values);

  const ReducedStructure& from_;
  const std::vector<int> order_;
  ReducedStructure structure_;
  std::vector<Target> targets_;  ///< of each entry; empty where the order changes nothing
  std::vector<double> values_;
};

}  // namespace bundle::fused
