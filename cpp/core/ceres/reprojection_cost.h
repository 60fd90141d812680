#pragma once

/// The reprojection residual (factors/reprojection.h) as a cost function of Ceres.

#include <atomic>
#include <cstdint>
#include <memory>

#include "core/ceres/ceres_version.h"
#include "core/factors/loss.h"
#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Counts the residuals that observations hold, for the reprojection costs of a solve.
struct HoldingWatch {
  LossType loss = LossType::kTrivial;
  double loss_scale = 1;
  std::atomic<int64_t> num_held{0};  ///< at the last state
  /// Set to true when the observations that count at a candidate differ from those at the state
  /// before it; the user resets it.
  std::atomic<bool> has_changed{false};
  /// True while derivatives are evaluated at a candidate.
  std::atomic<bool> is_at_candidate{false};
  /// True while derivatives are evaluated at a start, where all valid observations count.
  std::atomic<bool> is_at_start{false};
  /// The held cost, as far as it has been evaluated: at the last state, and at the last candidate.
  std::atomic<double> state_cost{0}, candidate_cost{0};
  /// At the last state, the cost of these observations if all valid ones counted
  /// (LeastSquares::CostOfAll).
  std::atomic<double> cost_if_all_count{0};

  /// Adds an observation with a held residual, with its squared norm in sigmas.
  void AddHeld(double squared_norm, std::atomic<double>* cost) const {
    double rho[3];
    ValueOfLoss(loss, loss_scale, squared_norm, rho);
    double sum = cost->load(std::memory_order_relaxed);
    while (!cost->compare_exchange_weak(sum, sum + 0.5 * rho[0], std::memory_order_relaxed)) {
    }
  }
};

/// Data that all reprojection costs of a solve share. Outlives them.
struct ReprojectionContext {
  const AdjustmentProblem& problem;
  const ParameterLayout& layout;
  const CameraStates& states;
  Cheirality cheirality;
  HoldingWatch* watch =
      nullptr;  ///< nullptr: observations that do not count are zero; no residual is held
  /// Once true, no cost can be evaluated any more, so that Ceres ends. nullptr: never.
  const std::atomic<bool>* abandoned = nullptr;
};

/// The residual of one observation, divided by its sigma, as a Ceres cost function. Its parameter
/// blocks are, in this order and if they are free: the point, then the image's blocks
/// (ParameterLayout::blocks_of). If the pose is that of a rig image, the derivatives w.r.t. it are
/// multiplied with the maps to its frame and its sensor (factors/rig_pose.h).
///
/// Camera parameters are read from `context.states`, not from the parameter blocks: an
/// EvaluationCallback keeps the two equal. The model must be in the registry.
///
/// An observation that does not count has the residual that it holds (factors/reprojection.h),
/// which depends on the states of the solve. Ceres' trust region asks for derivatives at these
/// states, and for the residual alone at candidates. Only its search along a projected step asks
/// for derivatives at candidates; HoldingWatch::is_at_candidate is then true.
std::unique_ptr<ceres::CostFunction> MakeReprojectionCost(const ReprojectionContext& context,
                                                          int64_t observation);

}  // namespace bundle
