#pragma once

/// Newton's method on a chordal cost, at any rank (derived in chordal_newton.cpp).

#include <Eigen/Core>

#include "core/pose_graph/certificate.h"
#include "core/pose_graph/chordal_cost.h"

namespace bundle {

/// Moves a point to a critical point of F without raising F. The first pose stays.
ChordalNewtonOutcome MinimizeChordal(const ChordalProblem& problem, int max_steps,
                                     Eigen::MatrixXd* point);

}  // namespace bundle
