#pragma once

/// Factors (factors/factor.h) as cost functions of Ceres, and factor graphs as its problems.

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/ceres/active_bounds.h"
#include "core/ceres/ceres_version.h"
#include "core/ceres/step_lengths.h"
#include "core/factors/factor.h"
#include "core/graph/factor_graph.h"
#include "core/model/camera_states.h"
#include "core/model/problem_factors.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// Returns the Ceres manifold with this name for a block of `size` numbers; nullptr for
/// "euclidean".
///
/// "quaternion_wxyz", "quaternion_xyzw" (4), "se3" (7: qx qy qz qw tx ty tz, as COLMAP stores a
/// pose), "sphere" (at least 2), "subset" with the entries that stay `constant`. Throws InputError
/// for any other name or a size that does not fit.
std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant);

/// Reason why costs can no longer be evaluated, so that Ceres ends: the user's request or an
/// exception of a factor.
struct Abandonment {
  std::atomic<bool> happened{false};
  FirstException exception;  ///< thrown by a factor; never Interrupted

  /// Returns the result of `evaluate`. Stores its exceptions, which Ceres cannot handle.
  template <typename Evaluate>
  bool Guard(const Evaluate& evaluate) noexcept {
    if (happened.load(std::memory_order_relaxed)) return false;
    try {
      return evaluate();
    } catch (const Interrupted&) {
    } catch (...) {
      exception.Keep();
    }
    happened.store(true);
    return false;
  }
};

/// A factor other than the observations of a problem, as a Ceres cost function. Its parameter
/// blocks are its free points, then its blocks of the layout (ChartedFactor::unknowns). Values of
/// the camera parameters are read from `states`, as in MakeReprojectionCost.
std::unique_ptr<ceres::CostFunction> MakeFactorCost(ChartedFactor factor,
                                                    const CameraStates& states,
                                                    Abandonment* abandonment);

/// A factor graph as a ceres::Problem.
///
/// A factor's Jacobian J is w.r.t. tangent coordinates. Ceres asks a cost function for derivatives
/// by the stored numbers and multiplies them with the manifold's PlusJacobian. It uses that matrix
/// for nothing else, so both are chosen such that the product is J itself. The cost function writes
/// [J 0], as wide as the stored value, and PlusJacobian is [I 0]^T, without the columns of constant
/// coordinates. No digit is lost and no derivative is computed twice.
///
/// Must outlive the ceres::Problem. The graph must not be moved or changed.
class CeresGraph {
 public:
  /// With `all_free`, constant coordinates count as free and bounds are left out.
  CeresGraph(const FactorGraph& graph, bool all_free);
  ~CeresGraph();
  CeresGraph(const CeresGraph&) = delete;
  CeresGraph& operator=(const CeresGraph&) = delete;

  ceres::Problem& problem() { return *problem_; }
  /// Values that Ceres changes; at first those of the graph.
  const std::vector<std::vector<double>>& values() const { return values_; }
  StepLengths& step_lengths() { return step_lengths_; }
  bool IsThreadSafe() const;
  /// nnz(J^T J) over the free coordinates, counting full blocks.
  int64_t CountInformationNonzeros() const;

  /// True once no factor can be evaluated any more, because the user ended the solve or a factor
  /// threw an exception. A request of the user to end the solve is tested before a candidate is
  /// evaluated, when Ceres can still return the best state.
  const std::atomic<bool>& abandoned() const { return abandonment_.happened; }
  /// Rethrows the exception of a factor, if any; does not throw Interrupted.
  void RethrowFactorException() { abandonment_.exception.Rethrow(); }

 private:
  class Cost;
  class BlockManifold;
  class Watch;
  /// Evaluates a factor and stores its exceptions, which must not pass through Ceres.
  bool Evaluate(const Factor& factor, double const* const* parameters, double* residuals,
                double** jacobians) const;

  const FactorGraph& graph_;
  std::vector<std::vector<double>> values_;
  std::vector<std::unique_ptr<ceres::Manifold>> manifolds_;
  std::vector<std::unique_ptr<ceres::CostFunction>> costs_;
  std::vector<std::unique_ptr<ceres::LossFunction>> losses_;
  ActiveBounds active_bounds_;
  StepLengths step_lengths_;
  std::unique_ptr<ceres::EvaluationCallback> watch_;
  std::unique_ptr<ceres::Problem> problem_;
  mutable Abandonment abandonment_;
};

}  // namespace bundle
