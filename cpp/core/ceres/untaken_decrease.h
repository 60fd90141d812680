#pragma once

/// Predicted decrease of the cost that remains after a solve by Ceres.

#include "core/ceres/ceres_version.h"

namespace bundle {

/// Lower bound of the further decrease of the cost, by its linearisation, if a solve accepted a
/// step and ended at another one by parameter tolerance; 0 after any other end. The problem is at
/// the state in which Ceres left it.
double UntakenDecrease(const ceres::Solver::Summary& summary, ceres::Problem* problem);

}  // namespace bundle
