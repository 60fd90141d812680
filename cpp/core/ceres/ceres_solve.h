#pragma once

/// One bundle adjustment by Ceres, step by step. Included only by solve_with_ceres.cpp and
/// build_ceres_problem.cpp.

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/ceres/active_bounds.h"
#include "core/ceres/ceres_graph.h"
#include "core/ceres/ceres_version.h"
#include "core/ceres/end_in_sigmas.h"
#include "core/ceres/reprojection_cost.h"
#include "core/ceres/settle_factors.h"
#include "core/ceres/solve_callbacks.h"
#include "core/ceres/solve_with_ceres.h"
#include "core/ceres/step_lengths.h"
#include "core/ceres/summarize.h"
#include "core/factors/factor.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/prepare/prepare.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Continuation of a solve that Ceres considers converged.
struct Continuation {
  /// True: continue at the same state with the same held residuals, because Ceres compares changes
  /// of the cost with a cost that includes the held cost. False: continue with all observations
  /// that can count.
  bool repeats = false;
  /// Ratio of the cost without the held cost to the cost that Ceres sees.
  double share = 1;
};

/// One solve by Ceres.
class CeresSolve {
 public:
  CeresSolve(const AdjustmentProblem& problem, const SolveOptions& options, PreparedSolve prepared,
             const MeasureDecrement& measure);

  SolveOutput Run(const ProgressCallback& progress);

 private:
  ceres::Solver::Summary SolveOnce(const ProgressCallback& progress,
                                   ceres::Solver::Options ceres_options, SolveOutput* output,
                                   const Continuation& continuation = {});
  /// Rewrites Ceres' message about the function tolerance for the cost without the held cost.
  void TellOfCostWithoutHeld(ceres::Solver::Summary* summary) const;
  /// Decides if a converged solve has to continue. Ceres judges steps by the cost with the held
  /// cost (factors/reprojection.h), but the function tolerance refers to the cost without it. And
  /// observations that were left out may now be in front of their cameras.
  std::optional<Continuation> FindContinuation(const ceres::Solver::Summary& summary) const;
  ceres::Solver::Options OptionsToGoOn(ceres::Solver::Options result,
                                       const ceres::Solver::Summary& summary,
                                       const Continuation& next);
  void Settle(ceres::Solver::Options options, ReportProgress* report, RememberBest* best,
              EndInSigmas* end, ceres::Solver::Summary* summary);
  /// The problem at the current state.
  struct Refined;
  /// True if observations in front of their cameras have a held residual.
  bool LeavesOut(const AdjustmentProblem& refined) const;
  NewtonDecrement Decrement() const;
  /// Returns to the best state, if the solve ends at another one without convergence.
  void ReturnToBest(const RememberBest& best, const ceres::Solver::Summary& summary);
  /// Residuals minus free parameters; 0 with a robust loss.
  double DegreesOfFreedom() const;
  /// True if a factor is not thread-safe: Ceres then uses one thread. Adds a warning.
  bool UseOneThread();
  ceres::Solver::Options ChooseSolver();
  /// Number of OpenBLAS threads: more than one only for the factorisation of a large reduced
  /// system.
  int BlasThreads(const ceres::Solver::Options& options) const;
  void Collect(const ceres::Solver::Summary& summary, SolveOutput* output);
  double* PointData(int point) { return numbers_.data() + 3 * static_cast<int64_t>(point); }
  double* State() { return numbers_.data() + num_coordinates_; }

  // build_ceres_problem.cpp
  void BuildProblem();
  void AddFactor(const Factor& factor);
  void AddBounds();
  void AddObservation(int64_t i);
  /// 1/2 rho(||r||^2) of an observation without free parameters.
  double Cost(const ceres::CostFunction& cost) const;
  static std::vector<double> StartNumbers(const AdjustmentProblem& problem,
                                          const ParameterLayout& layout);

  const MeasureDecrement& measure_;
  const AdjustmentProblem& problem_;
  const SolveOptions& options_;
  std::vector<Warning> warnings_;
  std::string linear_solver_choice_;
  ParameterLayout layout_;
  LargeVector<int64_t> track_lengths_;
  CameraStates states_;
  HoldingWatch watch_;
  RecordHolding record_holding_{&watch_};
  double distance_ = std::numeric_limits<double>::quiet_NaN();  ///< to the minimum, in sigmas
  double camera_distance_ = std::numeric_limits<double>::quiet_NaN();
  std::optional<double> best_cost_;  ///< cost of the state of ReturnToBest
  double share_ = 1;                 ///< Continuation::share of the last solve
  const int64_t num_coordinates_;    ///< coordinates of all points
  /// Coordinates of the points, then the state. Both are in one array because Ceres orders
  /// parameter blocks by address. With two arrays, their order and the last digits of results would
  /// vary.
  std::vector<double> numbers_;
  Abandonment abandonment_;
  ActiveBounds active_bounds_;
  StepLengths lengths_;
  UpdateCameraStates update_states_;
  ReprojectionContext context_;
  std::unique_ptr<ceres::LossFunction> loss_;
  std::vector<std::unique_ptr<ceres::LossFunction>> factor_losses_;
  std::vector<std::unique_ptr<ceres::CostFunction>> costs_;
  KindCosts factor_costs_;
  int64_t num_residuals_ = 0;
  std::unique_ptr<ceres::Problem> ceres_problem_;
  double fixed_cost_ = 0;
};

}  // namespace bundle
