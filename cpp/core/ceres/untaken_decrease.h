#pragma once

/// Decrease of the cost that a solve by Ceres left, as predicted by its model.

#include "core/ceres/ceres_version.h"

namespace bundle {

/// Lower bound of the further decrease of the cost, by its linearisation, if a solve accepted a
/// step and ended at another one by parameter tolerance; 0 after any other end. The problem is
/// where Ceres left it.
double UntakenDecrease(const ceres::Solver::Summary& summary, ceres::Problem* problem);

}  // namespace bundle
