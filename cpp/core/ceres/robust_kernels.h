#pragma once

/// What Ceres computes for a robust loss, for those who have no Ceres at hand.

#include <cstdint>

#include "core/interface/options.h"

namespace bundle {

/// rho, rho', rho'' at each of `count` squared norms >= 0; `values` is count x 3.
void EvaluateLoss(LossType type, double scale, int64_t count, const double* squared_norms,
                  double* values);

/// What Ceres makes of a residual block under a loss: r (rows) and J (rows x columns, row-major)
/// are overwritten by those that the solver sees, given rho, rho', rho'' at ||r||^2. rho' must be
/// positive where rho'' is.
void CorrectWithCeres(const double* rho, int rows, int columns, double* residual, double* jacobian);

}  // namespace bundle
