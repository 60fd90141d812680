#pragma once

/// The end that minimize/trust_region.cpp gives a solve with factors, for Ceres:
/// its tolerances look at all residuals together. Where one of them ends a solve, another one goes
/// on from there nearly without damping, until a step changes the cost of no kind of factors by
/// more than the function tolerance of its own. Both become one summary.

#include <cstdint>
#include <map>
#include <vector>

#include "core/ceres/ceres_version.h"

namespace bundle {

/// The costs of factors, by their kinds (KindOf).
class KindCosts {
 public:
  /// Keeps what it is given.
  void Add(uint32_t kind, const ceres::CostFunction& cost, const ceres::LossFunction* loss,
           const std::vector<double*>& blocks);
  bool empty() const { return factors_.empty(); }
  /// At what the blocks hold.
  std::vector<double> ByKind() const;

 private:
  struct One {
    uint32_t kind;
    const ceres::CostFunction* cost;
    const ceres::LossFunction* loss;
    std::vector<double*> blocks;
  };
  std::vector<One> factors_;
};

/// True if a solve ended by function or parameter tolerance.
bool EndedByTolerance(const ceres::Solver::Summary& summary);

/// Solves again from where `summary` ended, with its options, and adds that to it. False where the
/// new solve fails, which leaves all as it was. `callbacks` see the iterations numbered on.
bool SettleFactors(const KindCosts& factors, ceres::Solver::Options options,
                   const std::vector<ceres::IterationCallback*>& callbacks, ceres::Problem* problem,
                   ceres::Solver::Summary* summary);

}  // namespace bundle
