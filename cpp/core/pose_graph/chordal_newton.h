#pragma once

/// Newton's method on a chordal cost, at any rank (derived in chordal_newton.cpp).

#include <Eigen/Core>

#include "core/pose_graph/certificate.h"
#include "core/pose_graph/chordal_cost.h"

namespace bundle {

struct NewtonLimits {
  int max_steps = 0;
  bool is_patient = true;     ///< goes on although steps hardly lower F
  ProgressCallback progress;  ///< after each step; false ends it by the exception Interrupted
};

/// Moves a point to a critical point of F without raising F. The first pose stays.
ChordalNewtonOutcome MinimizeChordal(const ChordalProblem& problem, const NewtonLimits& limits,
                                     Eigen::MatrixXd* point);

}  // namespace bundle
