#pragma once

/// Strategies: computation of a step for the current radius, and of the next radius.

#include <string>

#include "core/interface/linear_status.h"
#include "core/minimize/least_squares.h"

namespace bundle {

struct Step {
  LinearStatus status = LinearStatus::kSuccess;
  int num_iterations = 0;  ///< iterations of the linear solver; 0 if it did not run
  std::string message;
  Candidate candidate;  ///< valid if `status` is kSuccess
};

class Strategy {
 public:
  virtual ~Strategy() = default;

  /// Damping for the linearisation at a new x.
  virtual double Damping() const = 0;

  /// Finds a step at x, where the problem has been linearised with Damping(), and evaluates it.
  /// Linearises again if a failed step requires another damping.
  virtual Step ComputeStep(LeastSquares* problem) = 0;

  /// Call one of these after each ComputeStep. `quality`: actual decrease over predicted decrease.
  virtual void StepAccepted(double quality) = 0;
  virtual void StepRejected() = 0;
  /// For a missing step, or a step without a predicted decrease.
  virtual void StepIsInvalid() = 0;

  virtual double Radius() const = 0;

  /// Removes nearly all damping from the following steps, beginning at this x. False if the damping
  /// was already that small.
  virtual bool Widen() { return false; }
};

}  // namespace bundle
