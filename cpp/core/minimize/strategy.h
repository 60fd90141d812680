#pragma once

/// Strategies: how a trust region finds a step for its radius, and the next radius.

#include <string>

#include "core/interface/linear_status.h"
#include "core/minimize/least_squares.h"

namespace bundle {

struct Step {
  LinearStatus status = LinearStatus::kSuccess;
  int num_iterations = 0;  ///< iterations of the linear solver; 0 if it did not run
  std::string message;
  Candidate candidate;  ///< where `status` is kSuccess
};

class Strategy {
 public:
  virtual ~Strategy() = default;

  /// Damping for the linearisation at a new x.
  virtual double Damping() const = 0;

  /// Finds a step at x, where the problem has been linearised with Damping(), and evaluates it.
  /// Linearises again if a failed step requires another damping.
  virtual Step ComputeStep(LeastSquares* problem) = 0;

  /// One of these follows each ComputeStep. `quality`: actual decrease over predicted decrease.
  virtual void StepAccepted(double quality) = 0;
  virtual void StepRejected() = 0;
  /// There was no step, or one without a predicted decrease.
  virtual void StepIsInvalid() = 0;

  virtual double Radius() const = 0;

  /// Removes nearly all damping from the following steps, beginning at this x. False if there was
  /// hardly any.
  virtual bool Widen() { return false; }
};

}  // namespace bundle
