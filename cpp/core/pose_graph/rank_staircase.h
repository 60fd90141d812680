#pragma once

/// Riemannian staircase: from a point without a certificate to a point of lower cost (derived in
/// rank_staircase.cpp).

#include <Eigen/Core>

#include "core/pose_graph/chordal_cost.h"
#include "core/pose_graph/dual_certificate.h"

namespace bundle {

struct StaircaseOutcome {
  int rank = 0;             ///< last rank of the relaxation
  double relaxed_cost = 0;  ///< F at this rank
  DualBound relaxed_bound;  ///< valid for any poses; `holds`: the relaxation is solved
  Eigen::MatrixXd point;    ///< rounded to poses, not refined
};

/// `direction`: eigenvector of a negative eigenvalue of S at `point`, whose bound is `before`.
StaircaseOutcome ClimbStaircase(const ChordalProblem& problem, const DualBound& before,
                                Eigen::MatrixXd point, Eigen::VectorXd direction, int max_rank,
                                const ProgressCallback& progress);

}  // namespace bundle
