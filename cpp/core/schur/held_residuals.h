#pragma once

/// Observations of a plan with a held residual at a state (factors/reprojection.h). Memory: 24
/// bytes for each of these observations, and none for the others.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/factors/loss.h"
#include "core/sums/double_double.h"

namespace bundle {

struct HeldResidual {
  int64_t observation;  ///< index in the plan
  double residual[2];
};

/// Receiver of the observations of a chunk with a held residual; disabled if `add` is nullptr.
struct HeldSink {
  void (*add)(void* list, const HeldResidual& held) = nullptr;
  void* list = nullptr;
};

class HeldResiduals {
 public:
  explicit HeldResiduals(size_t num_chunks) : of_chunk_(num_chunks) {}

  /// Clears the residuals of a chunk and returns the sink for a pass over it. Chunks are
  /// independent.
  HeldSink Collect(size_t chunk);

  /// Merges the lists of all chunks, after a pass.
  void Merge();

  /// Removes all.
  void Clear();

  /// Removes the observations for which `counts` is true. Returns their number.
  template <typename Predicate>
  int64_t Release(const Predicate& counts) {
    const auto end = std::remove_if(all_.begin(), all_.end(), counts);
    const int64_t number = all_.end() - end;
    all_.erase(end, all_.end());
    return number;
  }

  /// The held cost: sum of 1/2 rho(||h||^2).
  DoubleDouble Cost(LossType loss, double loss_scale) const;

  /// Ascending.
  const std::vector<HeldResidual>& all() const { return all_; }

  /// True if the same observations have held residuals.
  bool HasSameObservations(const HeldResiduals& other) const;

 private:
  std::vector<std::vector<HeldResidual>> of_chunk_;
  std::vector<HeldResidual> all_;
};

}  // namespace bundle
