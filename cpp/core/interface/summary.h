#pragma once

/// Report of a solve, for both backends: iterations, a summary with Ceres' names (as in
/// ceres::Solver::Summary::FullReport), and warnings. A warning has a text for users and a name for
/// programs.

#include <chrono>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/interface/options.h"
#include "core/problem/problem_view.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// python/bundle/interface/warning_kinds.py explains each kind (a test compares the names).
enum class WarningKind {
  kGaugeNotHeld,
  kGaugeBesideFactors,
  kPointsSeenOnce,
  kFarOrigin,
  kFarPoints,
  kFarPointsDominate,
  kSingleThread,
  kPreconditionerNotUsed,
  kOrderingNotUsed,
  kOrderingReplaced,
  kSolverReplaced,
  kPreconditionerReplaced,
  kFactorLargerThanPredicted,
  kResidualNotFinite,
  kSuspiciousSteps,
  kSuspiciousJacobian,
  kInvalidSolution,
  kObservationsBehind,
  kTooManyBehind,
  kObservationsLeftOut,
  kNoProjection,
  kSteepEnd,
  kFormulaJump,
  kWorldScale,
};

inline constexpr NamedValue<WarningKind> kWarningKinds[] = {
    {"gauge_not_held", WarningKind::kGaugeNotHeld},
    {"gauge_beside_factors", WarningKind::kGaugeBesideFactors},
    {"points_seen_once", WarningKind::kPointsSeenOnce},
    {"far_origin", WarningKind::kFarOrigin},
    {"far_points", WarningKind::kFarPoints},
    {"far_points_dominate", WarningKind::kFarPointsDominate},
    {"single_thread", WarningKind::kSingleThread},
    {"preconditioner_not_used", WarningKind::kPreconditionerNotUsed},
    {"ordering_not_used", WarningKind::kOrderingNotUsed},
    {"ordering_replaced", WarningKind::kOrderingReplaced},
    {"solver_replaced", WarningKind::kSolverReplaced},
    {"preconditioner_replaced", WarningKind::kPreconditionerReplaced},
    {"factor_larger_than_predicted", WarningKind::kFactorLargerThanPredicted},
    {"residual_not_finite", WarningKind::kResidualNotFinite},
    {"suspicious_steps", WarningKind::kSuspiciousSteps},
    {"suspicious_jacobian", WarningKind::kSuspiciousJacobian},
    {"invalid_solution", WarningKind::kInvalidSolution},
    {"observations_behind", WarningKind::kObservationsBehind},
    {"too_many_behind", WarningKind::kTooManyBehind},
    {"observations_left_out", WarningKind::kObservationsLeftOut},
    {"no_projection", WarningKind::kNoProjection},
    {"steep_end", WarningKind::kSteepEnd},
    {"formula_jump", WarningKind::kFormulaJump},
    {"world_scale", WarningKind::kWorldScale}};

struct Warning {
  WarningKind kind;
  std::string text;  ///< one sentence
};

/// Appends a warning, unless its text is empty.
inline void Warn(WarningKind kind, std::string text, std::vector<Warning>* warnings) {
  if (!text.empty()) warnings->push_back({kind, std::move(text)});
}

/// Wall time since construction.
class Stopwatch {
 public:
  double seconds() const { return std::chrono::duration<double>(Clock::now() - start_).count(); }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point start_ = Clock::now();
};

/// ceres::IterationSummary; times in seconds.
struct IterationRecord {
  int iteration = 0;
  double cost = 0;
  double cost_change = 0;
  double gradient_max_norm = 0;
  double step_norm = 0;
  double relative_decrease = 0;
  double trust_region_radius = 0;
  int linear_solver_iterations = 0;
  bool step_is_successful = false;
  double iteration_time_in_seconds = 0;
  double cumulative_time_in_seconds = 0;

  // Not in Ceres, and not reported.
  /// True if the step changes which observations count, so that the decrease predicted by the model
  /// does not apply. Also true if there is no step, and observations count that were left out
  /// before.
  bool changes_what_counts = false;
};

/// Cost of the last accepted iteration, if iterations changed which observations count. The costs
/// of other iterations are then sums over other observations.
inline std::optional<double> CostOfWhatCounts(const std::vector<IterationRecord>& iterations) {
  std::optional<double> cost;
  bool changed = false;
  for (const IterationRecord& record : iterations) {
    changed = changed || record.changes_what_counts;
    if (record.step_is_successful) cost = record.cost;
  }
  return changed ? cost : std::nullopt;
}

/// The matrix that each step factorises, and its Cholesky factor L. Nonzeros of matrices include
/// both triangles and the diagonal; those of L are the lower triangle with the diagonal. Blocks
/// count as full. A field is empty if the number does not exist (conjugate gradients have no
/// factor) or is unknown.
struct FactorSummary {
  std::optional<int64_t> num_columns;           ///< n
  std::optional<int64_t> num_reduced_nonzeros;  ///< nnz(S) as its solver stores it: n^2 if dense
  std::optional<int64_t> num_nonzeros;          ///< nnz(L)
  std::optional<double> flops;                  ///< FactorCounts::flops
  std::string ordering;                         ///< ordering by which the columns are eliminated
  std::optional<double> symbolic_time_in_seconds;
};

/// As ceres::Solver::Summary: enumerations by Ceres' names, times in seconds, -1 if not measured.
struct SolveSummary {
  double initial_cost = -1;
  double final_cost = -1;
  /// Cost of observations and factors without free parameters; included in the other two.
  double fixed_cost = -1;
  /// Cost of the held residuals of observations that do not count at the solution
  /// (factors/reprojection.h); not included in the others.
  double held_cost = 0;
  std::string termination_type;
  std::string message;
  bool is_solution_usable = false;
  int num_successful_steps = -1;
  int num_unsuccessful_steps = -1;
  int num_parameter_blocks = -1;
  int num_parameters = -1;
  int num_residual_blocks = -1;
  int num_residuals = -1;
  int num_parameter_blocks_reduced = -1;
  int num_parameters_reduced = -1;
  int num_residual_blocks_reduced = -1;
  int num_residuals_reduced = -1;
  std::string trust_region_strategy_type;
  std::string dogleg_type;
  std::string linear_solver_type_given;
  std::string linear_solver_type_used;
  std::vector<int> linear_solver_ordering_given;
  std::vector<int> linear_solver_ordering_used;
  std::string schur_structure_given;
  std::string schur_structure_used;
  std::string preconditioner_type_given;
  std::string preconditioner_type_used;
  std::string dense_linear_algebra_library_type;
  std::string sparse_linear_algebra_library_type;
  int num_threads_given = -1;
  int num_threads_used = -1;
  double preprocessor_time_in_seconds = -1;
  double residual_evaluation_time_in_seconds = -1;
  double jacobian_evaluation_time_in_seconds = -1;
  double linear_solver_time_in_seconds = -1;
  double minimizer_time_in_seconds = -1;
  double postprocessor_time_in_seconds = -1;
  double total_time_in_seconds = -1;
  int num_residual_evaluations = -1;
  int num_jacobian_evaluations = -1;
  int num_linear_solves = -1;

  // Not in Ceres.
  int num_factors = 0;  ///< factors other than observations
  std::string backend_given;
  std::string backend_used;
  std::string backend_choice;        ///< reason for this backend, if it was chosen automatically
  std::string instruction_set;       ///< instruction set of the fused kernels
  std::string linear_solver_choice;  ///< reason for this solver, if it was chosen automatically
  int64_t num_information_nonzeros = -1;  ///< nnz(J^T J) over all free unknowns
  FactorSummary factor;
  bool interrupted = false;
  /// Predicted decrease of the step that met the parameter tolerance. This step is not taken and
  /// has no record. 0: unknown. Not reported.
  double untaken_decrease = 0;
  /// Distance to the minimum in standard deviations of the solution, of any function of the
  /// parameters and of any function of the camera parameters (minimize/sigma_rule.h). NaN: not
  /// computed.
  double distance_in_sigmas = std::numeric_limits<double>::quiet_NaN();
  double largest_camera_step_in_sigmas = std::numeric_limits<double>::quiet_NaN();
  std::vector<double>
      origin;  ///< centre about which the scene was solved; empty: the problem's origin
  std::vector<Warning> warnings;
};

/// Called after each iteration. Returning false stops the solve with the best state; within an
/// iteration, an InterruptionScope does this. Before the first evaluation is complete there is no
/// state to keep, and Interrupted is thrown.
using ProgressCallback = std::function<bool(const IterationRecord&)>;

/// Report of a solve, for any kind of problem.
struct SolveRecord {
  SolveSummary summary;
  std::vector<IterationRecord> iterations;
  double build_time_in_seconds = 0;  ///< time outside the solver
  double solve_time_in_seconds = 0;  ///< time inside the solver
};

struct SolveOutput : SolveRecord {
  std::vector<double> cam_from_world;    ///< as in ProblemView
  std::vector<double> rig_from_world;    ///< as in ProblemView
  std::vector<double> sensor_from_rig;   ///< as in ProblemView
  std::vector<double> camera_params;     ///< as in ProblemView
  LargeVector<double> points;            ///< as in ProblemView
  std::vector<double> twists, readouts;  ///< as in ProblemView; empty without rolling shutters
  /// Cost 1/2 rho(||r||^2) of each factor other than observations, at the start and at the
  /// solution; NaN if it has no value.
  std::vector<double> factor_costs_before;
  std::vector<double> factor_costs_after;

  /// Makes a view read the twists and readouts of this solution.
  void PutShutters(ProblemView* view) const {
    if (twists.empty()) return;
    view->twists = twists.data();
    view->readouts = readouts.data();
  }
};

}  // namespace bundle
