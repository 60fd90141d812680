#pragma once

/// A second solve by Ceres until the factors settle (interface/settling.h). Ceres tests its
/// tolerances on all residuals together, so the convergence of each kind of factors is tested here.
/// Both solves are combined in one summary.

#include <cstdint>
#include <functional>
#include <map>
#include <vector>

#include "core/ceres/ceres_version.h"

namespace bundle {

/// Computes the costs of factors, by their kinds (KindOf).
class KindCosts {
 public:
  /// Keeps the pointers.
  void Add(uint32_t kind, const ceres::CostFunction& cost, const ceres::LossFunction* loss,
           const std::vector<double*>& blocks);
  bool empty() const { return factors_.empty(); }
  /// Costs by kind, at the current values of the blocks.
  std::vector<double> ByKind() const;
  /// Expected costs by kind, if the sigmas are right.
  std::vector<double> Expected() const;

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

/// Solves again from the end of `summary`, with its options, and adds the new iterations to it. If
/// the new solve fails, returns false and changes nothing. `callbacks` get the iterations with
/// continued numbers. `may_end` is asked at each accepted step, if it meets the function tolerance
/// for the total cost and for each kind.
using MayEnd = std::function<bool(const ceres::IterationSummary&, bool meets_tolerance)>;
bool SettleFactors(const KindCosts& factors, ceres::Solver::Options options,
                   const std::vector<ceres::IterationCallback*>& callbacks, const MayEnd& may_end,
                   ceres::Problem* problem, ceres::Solver::Summary* summary);

}  // namespace bundle
