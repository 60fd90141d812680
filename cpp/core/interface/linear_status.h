#pragma once

namespace bundle {

/// Outcome of solving a linear system for a step.
enum class LinearStatus {
  kSuccess,  ///< also if an iterative solver stopped at its limit, as in Ceres
  kFailure,  ///< not positive definite, or not finite: more damping may help
  kFatal,    ///< no damping can help: for example, memory ran out
};

}  // namespace bundle
