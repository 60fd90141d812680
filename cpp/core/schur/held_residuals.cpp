#include "core/schur/held_residuals.h"

#include <algorithm>

namespace bundle {

HeldSink HeldResiduals::Collect(size_t chunk) {
  of_chunk_[chunk].clear();
  return {[](void* list, const HeldResidual& held) {
            static_cast<std::vector<HeldResidual>*>(list)->push_back(held);
          },
          &of_chunk_[chunk]};
}

void HeldResiduals::Merge() {
  all_.clear();
  for (const std::vector<HeldResidual>& chunk : of_chunk_) {
    all_.insert(all_.end(), chunk.begin(), chunk.end());
  }
  // A chunk of several camera models goes through its observations model by model.
  std::sort(all_.begin(), all_.end(), [](const HeldResidual& a, const HeldResidual& b) {
    return a.observation < b.observation;
  });
}

void HeldResiduals::Clear() {
  for (std::vector<HeldResidual>& chunk : of_chunk_) chunk.clear();
  all_.clear();
}

DoubleDouble HeldResiduals::Cost(LossType loss, double loss_scale) const {
  DoubleDouble cost;
  for (const HeldResidual& held : all_) {
    const double* const h = held.residual;
    double rho[3];
    ValueOfLoss(loss, loss_scale, h[0] * h[0] + h[1] * h[1], rho);
    cost.Add(0.5 * rho[0]);
  }
  return cost;
}

bool HeldResiduals::HasSameObservations(const HeldResiduals& other) const {
  return std::equal(
      all_.begin(), all_.end(), other.all_.begin(), other.all_.end(),
      [](const HeldResidual& a, const HeldResidual& b) { return a.observation == b.observation; });
}

}  // namespace bundle
