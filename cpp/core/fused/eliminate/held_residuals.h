#pragma once

/// The observations of a plan that hold a residual at a state (residuals/held_residual.h). Memory:
/// 24 bytes for each of them, nothing for those that count.

#include <cstddef>
#include <cstdint>
#include <vector>

namespace bundle::fused {

struct HeldResidual {
  int64_t observation;  ///< of the plan
  double residual[2];
};

/// Where a pass puts the observations of a chunk that hold a residual; nowhere if `add` is nullptr.
struct HeldSink {
  void (*add)(void* list, const HeldResidual& held) = nullptr;
  void* list = nullptr;
};

class HeldResiduals {
 public:
  explicit HeldResiduals(size_t num_chunks) : of_chunk_(num_chunks) {}

  /// Forgets what a chunk held and takes what a pass over it finds. Chunks are independent.
  HeldSink Collect(size_t chunk);

  /// Puts together what all chunks hold, after a pass.
  void Merge();

  /// Ascending.
  const std::vector<HeldResidual>& all() const { return all_; }

  /// True if the same observations hold a residual.
  bool HasSameObservations(const HeldResiduals& other) const;

 private:
  std::vector<std::vector<HeldResidual>> of_chunk_;
  std::vector<HeldResidual> all_;
};

}  // namespace bundle::fused
