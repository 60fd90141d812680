#pragma once

/// Decrease of the cost that a solve by Ceres left, as predicted by its model.

#include "core/ceres/ceres_version.h"

namespace bundle {

/// A lower bound of what the cost would fall by, by its linearisation, after a step that was
/// accepted and another that met the parameter tolerance; 0 after any other end. The problem is
/// where Ceres left it.
double UntakenDecrease(const ceres::Solver::Summary& summary, ceres::Problem* problem);

}  // namespace bundle
