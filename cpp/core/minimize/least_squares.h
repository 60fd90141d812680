#pragma once

/// Interface of a least-squares problem, f(x) = 1/2 sum rho(||r_i(x)||^2), for a trust region
/// method. Linearisations and evaluations are passes over all residuals. The problem stores the
/// state x, a candidate, and the two directions whose combination is a step. The trust region
/// method receives only scalars.
///
/// J and r are corrected for the loss (factors/loss.h). s_j = 1 / (1 + ||J e_j||) at the first
/// linearisation is the Jacobi scaling of column j, which is constant during a solve. With c_j =
/// ||J e_j||^2 at x, the trust region method measures steps in units of D^-1,
///
///   D_j^2 = clamp(s_j^2 c_j, min_diagonal, max_diagonal) / s_j^2,
///
/// and the two directions at x are
///
///   gradient direction   p = D^-2 J^T r,
///   Newton direction     q: (J^T J + damping D^2) q = -J^T r.
///
/// A problem may have a held cost, which is constant near a state but may differ between states. It
/// is added to the cost only when a step is judged (derived in factors/reprojection.h).
///
/// A problem may have bounds on coordinates of x. Its candidates are then P(x + d), where P moves
/// each coordinate to the nearest value within its bounds. Both directions ignore the bounds. x
/// itself satisfies them.

#include <optional>
#include <string>

#include "core/interface/linear_status.h"
#include "core/minimize/sigma_rule.h"

namespace bundle {

struct Linearization {
  bool is_finite = true;
  double cost = 0;
  double held_cost = 0;
  double gradient_norm = 0;  ///< ||J^T r||_2
  /// ||J^T r||_inf; with bounds ||P(x - J^T r) - x||_inf. Rotations may count as quaternions
  /// (schur/linearize.cpp).
  double gradient_max_norm = 0;
};

struct NewtonResult {
  LinearStatus status = LinearStatus::kSuccess;
  int num_iterations = 0;
  std::string message;
};

/// Inner products of the two directions. They include those with J^T r: p^T J^T r = d_pp and q^T
/// J^T r = d_pq.
struct DoglegProducts {
  double d_pp = 0, d_pq = 0, d_qq = 0;  ///< p^T D^2 p and so on
  double j_pp = 0, j_pq = 0, j_qq = 0;  ///< p^T J^T J p and so on
};

struct Candidate {
  double model_cost_change = 0;  ///< -(J d)^T (r + J d / 2) for the step d
  double step_norm = 0;          ///< ||d||; with bounds ||P(x + d) - x||
  double cost = 0;               ///< at the candidate; not finite if a residual is not finite
  double held_cost = 0;          ///< at the candidate
  /// True if the set of residuals that count differs from that at x, so that the model does not
  /// apply.
  bool changes_what_counts = false;
  /// Bound on the effect of the summation order on the difference of costs, with a margin. 0: the
  /// difference is the same for all orders that occur.
  double cost_uncertainty = 0;
  bool has_factors = false;  ///< factors other than observations
  /// Largest change of the cost of one kind of these factors, relative to its own cost.
  double factors_change = 0;
};

/// The step d of the last Newton or dogleg step, not projected.
struct StepLine {
  double slope = 0;     ///< d^T J^T r at x
  double max_norm = 0;  ///< ||d||_inf
};

class LeastSquares {
 public:
  virtual ~LeastSquares() = default;

  /// Computes cost and gradient at x, and the normal equations with `damping`, eliminated as far as
  /// SolveNewton needs them. Called again at the same x if only the damping changed.
  virtual Linearization Linearize(double damping) = 0;

  /// Computes q. `eta`: forcing term for iterative solvers.
  virtual NewtonResult SolveNewton(double eta) = 0;

  /// Evaluates the candidate x + q: the step of LevenbergMarquardt.
  virtual Candidate EvaluateNewtonStep() = 0;

  /// Products of p and q; call after SolveNewton, for doglegs only.
  virtual DoglegProducts Products() = 0;

  /// Evaluates the candidate x + a p + b q. Call after Products, and again with other a and b after
  /// a rejected step.
  virtual Candidate EvaluateDoglegStep(double a, double b) = 0;

  /// Swaps x and the last candidate. A second call undoes the first.
  virtual void Accept() = 0;

  /// ||x|| over all refined parameters.
  virtual double StateNorm() const = 0;

  /// Degrees of freedom of the residuals, at most 0 if their standard deviation cannot be
  /// estimated. nullopt: the solve ends by Ceres' rules, without its last step.
  virtual std::optional<double> DegreesOfFreedom() const { return std::nullopt; }

  /// Damping that asks Linearize for the normal equations of Decrement. Directions with less
  /// information relative to that of their columns do not count. Undetermined directions have none,
  /// and no gradient. A problem may damp more those parts of x that can move far without changing
  /// the cost.
  static constexpr double kDecrementDamping = 1e-12;
  virtual bool HasDecrement() const { return false; }
  /// The Newton decrements at x; call after Linearize(kDecrementDamping).
  virtual NewtonDecrement Decrement() { return {}; }

  /// The cost at x if all valid observations counted, after Linearize or Accept: the cost, and for
  /// each observation with a held residual the cost of its residual or, behind its camera, of the
  /// one that it holds. The trust region method keeps the best of these states.
  virtual double CostOfAll() { return std::numeric_limits<double>::quiet_NaN(); }
  /// Keeps a copy of the state before the last Accept.
  virtual void KeepPrevious() {}
  /// Makes the kept state x again.
  virtual void ReturnToKept() {}

  /// True if a coordinate has a bound. The three passes below are for such problems, along the d of
  /// the last EvaluateNewtonStep or EvaluateDoglegStep.
  virtual bool HasBounds() const { return false; }
  virtual StepLine LineAlongStep() { return {}; }
  /// Evaluates the candidate P(x + a d), without its model cost change.
  virtual Candidate EvaluateAlongStep(double /*a*/) { return {}; }
  /// d^T J^T r at the last candidate.
  virtual double SlopeAtCandidate() { return 0; }
};

}  // namespace bundle
