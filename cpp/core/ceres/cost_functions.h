#pragma once

/// What Ceres evaluates: the reprojection residual (factors/reprojection.h) and other factors
/// (factors/factor.h) as cost functions, manifolds, and references for Jacobians of any of them.

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/ceres/active_bounds.h"
#include "core/ceres/ceres_version.h"
#include "core/ceres/reference_checks.h"
#include "core/ceres/step_lengths.h"
#include "core/factors/loss.h"
#include "core/graph/factor_graph.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// A Ceres manifold by name, for a block of `size` numbers; nullptr for "euclidean".
///
/// "quaternion_wxyz", "quaternion_xyzw" (4), "se3" (7: qx qy qz qw tx ty tz, as COLMAP stores a
/// pose), "sphere" (at least 2), "subset" with the entries that stay `constant`. Throws InputError
/// for any other name or a size that does not fit.
std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant);

/// Why costs have no value any more, so that Ceres ends: the user wants it, or a factor threw.
struct Abandonment {
  std::atomic<bool> happened{false};
  FirstException exception;  ///< that a factor threw; Interrupted is none of it

  /// What `evaluate` returns, but no exception leaves: Ceres does not expect any.
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

/// A factor beside the observations of a problem as Ceres sees it. Its parameter blocks are its
/// free points, then its blocks of the layout (ChartedFactor::unknowns). Values of the camera
/// parameters are read from `states`, as MakeReprojectionCost does.
std::unique_ptr<ceres::CostFunction> MakeFactorCost(ChartedFactor factor,
                                                    const CameraStates& states,
                                                    Abandonment* abandonment);

/// A factor graph as a ceres::Problem.
///
/// A factor's Jacobian J is by tangent coordinates, but Ceres asks a cost function for derivatives
/// by the numbers that are stored and multiplies them with the manifold's PlusJacobian. As it uses
/// that matrix for nothing else, both are chosen so that the product is J itself: the cost function
/// writes [J 0], as wide as the stored value, and PlusJacobian is [I 0]^T, without the columns of
/// coordinates that are held. No digit is lost and nothing is differentiated twice.
///
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
  StepLengths& step_lengths() { return step_lengths_; }
  bool IsThreadSafe() const;
  /// nnz(J^T J) over the free coordinates, blocks full.
  int64_t CountInformationNonzeros() const;

  /// True once no factor has a value any more, because the user wants the solve to end or a factor
  /// threw. Looks for the user's wish before a candidate is evaluated, when Ceres can still be left
  /// with the best state.
  const std::atomic<bool>& abandoned() const { return abandonment_.happened; }
  /// Throws what a factor threw, if one did; Interrupted is none of it.
  void RethrowFactorException() { abandonment_.exception.Rethrow(); }

 private:
  class Cost;
  class BlockManifold;
  class Watch;
  /// Evaluates a factor; what it throws is kept, as nothing may leave through Ceres.
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

/// Residuals that observations hold, as the reprojection costs of a solve count them.
struct HoldingWatch {
  LossType loss = LossType::kTrivial;
  double loss_scale = 1;
  std::atomic<int64_t> num_held{0};  ///< at the last state
  /// Since this was last set to false, others counted at a candidate than at the state before.
  std::atomic<bool> has_changed{false};
  /// Derivatives that are asked for now are at a candidate.
  std::atomic<bool> is_at_candidate{false};
  /// The state that derivatives are asked for is a start, where all counts that can.
  std::atomic<bool> is_at_start{false};
  /// The held cost, as far as it has been evaluated: of the last state, of the last candidate.
  std::atomic<double> state_cost{0}, candidate_cost{0};

  /// Adds an observation that holds a residual, with its squared norm in sigmas.
  void AddHeld(double squared_norm, std::atomic<double>* cost) const {
    double rho[3];
    ValueOfLoss(loss, loss_scale, squared_norm, rho);
    double sum = cost->load(std::memory_order_relaxed);
    while (!cost->compare_exchange_weak(sum, sum + 0.5 * rho[0], std::memory_order_relaxed)) {
    }
  }
};

/// What all reprojection costs of a solve share. Outlives them.
struct ReprojectionContext {
  const AdjustmentProblem& problem;
  const ParameterLayout& layout;
  const CameraStates& states;
  Cheirality cheirality;
  HoldingWatch* watch = nullptr;  ///< nullptr: what does not count is zero, and nothing is held
  /// Once true, no cost can be evaluated any more, so that Ceres ends. nullptr: never.
  const std::atomic<bool>* abandoned = nullptr;
};

/// The residual of one observation, divided by its sigma, as Ceres sees it. Its parameter blocks
/// are, in this order and as far as they are free: the point, then the image's blocks
/// (ParameterLayout::blocks_of). The derivatives by an image's own pose, if that is a rig's, are
/// multiplied with the maps to its frame and its sensor (factors/rig_pose.h).
///
/// Camera parameters are read from `context.states`, not from the parameters: an EvaluationCallback
/// keeps the two equal. The model is one of the registry's and known.
///
/// An observation that does not count has the residual that it holds (factors/reprojection.h),
/// which depends on the states of the solve. Ceres' trust region asks for derivatives at these, and
/// for the residual alone at candidates; only its search along a projected step asks for
/// derivatives at candidates, which HoldingWatch::is_at_candidate tells apart.
std::unique_ptr<ceres::CostFunction> MakeReprojectionCost(const ReprojectionContext& context,
                                                          int64_t observation);

/// Two references for the Jacobians of one cost function at one point.
///
/// The first is ceres::GradientChecker, which users know. It differentiates along the tangent space
/// of the manifolds, so that errors along their normals hide, with a step of 1e-2 (of 1e-2 of the
/// parameter) that it shrinks at most a thousandfold, and compares an entry absolutely where one
/// side is exactly zero. Its numbers are kept, its verdict only counted.
///
/// The second reference (richardson.h) is taken in the ambient space, parameter by parameter, and
/// along the manifolds' Plus, without their PlusJacobian, and comes with a bound on its error.

/// Manifolds of a cost function's blocks, one each; nullptr: Euclidean.
using Manifolds = std::vector<const ceres::Manifold*>;

int AmbientSize(const ceres::CostFunction& cost);
int TangentSize(const ceres::CostFunction& cost, const Manifolds& manifolds);

/// What is known of a cost function beforehand.
struct KnownScales {
  /// Bounds of the first step of each ambient column, unless empty: the distance to a singularity.
  std::vector<double> largest_steps;
  /// Size of the numbers whose difference a residual is: it is rounded as they are.
  double minuend = 0;
};

ReferenceJacobians DifferentiateByRichardson(const ceres::CostFunction& cost,
                                             const Manifolds& manifolds,
                                             const std::vector<const double*>& parameters,
                                             const KnownScales& known = {});

GradientCheckerProbe RunGradientChecker(const ceres::CostFunction& cost, const Manifolds& manifolds,
                                        const std::vector<const double*>& parameters,
                                        double relative_precision);

}  // namespace bundle
