#pragma once
///
/// A coordinate at a bound is *active* if the cost falls beyond the bound. Ceres projects a step
/// onto the bounds after it has computed it, and then compares the decrease of the cost with that
/// of a model in which active coordinates have left their bounds. If they have most of the gradient
/// the ratio is near zero, every step is rejected, and the solve "converges" where it stands
/// (ceres-solver issue 187). So wherever Jacobians are wanted we first find the active coordinates,
/// by the gradient, and give them zero columns: they stay where they are and the model knows it
/// (Bertsekas, "Projected Newton methods for optimization problems with simple constraints", 1982).

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/graph/factor_graph.h"
#include "core/interface/summary.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// A Ceres manifold by name, for a block of `size` numbers; nullptr for "euclidean".
///
/// "quaternion_wxyz", "quaternion_xyzw" (4), "se3" (7: qx qy qz qw tx ty tz, as COLMAP stores a
/// pose), "sphere" (at least 2), "subset" with the entries that stay `constant`. Throws InputError
/// for any other name or a size that does not fit.
std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant);

/// A factor graph as a ceres::Problem.
///
/// A factor's Jacobian J is by tangent coordinates, but Ceres asks a cost function for derivatives
/// by the numbers that are stored and multiplies them with the manifold's PlusJacobian. As it uses
/// that matrix for nothing else, both are chosen so that the product is J itself: the cost function
/// writes [J 0], as wide as the stored value, and PlusJacobian is [I 0]^T, without the columns of
/// coordinates that are held. No digit is lost and nothing is differentiated twice.

/// Lives as long as the ceres::Problem does. The graph stays where it is and is not changed.
class CeresGraph {
 public:
  /// With `all_free`, held coordinates count as free ones and bounds are left out.
  CeresGraph(const FactorGraph& graph, bool all_free);
  ~CeresGraph();
  CeresGraph(const CeresGraph&) = delete;
  CeresGraph& operator=(const CeresGraph&) = delete;

  ceres::Problem& problem() { return *problem_; }
  /// Those that Ceres works on, which begin as the graph's.
  const std::vector<std::vector<double>>& values() const { return values_; }
  bool IsThreadSafe() const;
  /// nnz(J^T J) over the free coordinates, blocks full.
  int64_t CountInformationNonzeros() const;

  /// True once no factor has a value any more, because the user wants the solve to end or a factor
  /// threw. Looks for the user's wish before a candidate is evaluated, when Ceres can still be left
  /// with the best state.
  const std::atomic<bool>& abandoned() const { return abandoned_; }
  /// Throws what a factor threw, if one did; Interrupted is none of it.
  void RethrowFactorException() { exception_.Rethrow(); }

 private:
  class Cost;
  class BlockManifold;
  class Watch;
  /// A block with bounds.
  struct Bounded {
    int block;
    std::vector<int> factors;  ///< that touch it
    std::vector<bool> is_active;
  };

  /// Evaluates a factor; what it throws is kept, as nothing may leave through Ceres.
  bool Evaluate(const Factor& factor, double const* const* parameters, double* residuals,
                double** jacobians) const;
  void FindActiveCoordinates();
  std::vector<double> GradientOf(const Bounded& bounded) const;

  const FactorGraph& graph_;
  std::vector<std::vector<double>> values_;
  std::vector<std::unique_ptr<ceres::Manifold>> manifolds_;
  std::vector<std::unique_ptr<ceres::CostFunction>> costs_;
  std::vector<std::unique_ptr<ceres::LossFunction>> losses_;
  std::vector<Bounded> bounded_;
  std::vector<int> bounded_of_block_;  ///< -1: without bounds
  std::unique_ptr<ceres::EvaluationCallback> watch_;
  std::unique_ptr<ceres::Problem> problem_;
  mutable std::atomic<bool> abandoned_{false};
  mutable FirstException exception_;
};

}  // namespace bundle
