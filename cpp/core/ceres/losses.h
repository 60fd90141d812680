#pragma once

/// Robust losses of Ceres, for its solves and as a reference for factors/loss.h.

#include <cstdint>
#include <memory>

#include "core/factors/loss.h"

namespace ceres {
class LossFunction;
}  // namespace ceres

namespace bundle {

/// rho, rho', rho'' at each of `count` squared norms >= 0; `values` is count x 3.
void EvaluateLoss(LossType type, double scale, int64_t count, const double* squared_norms,
                  double* values);

/// Corrects a residual block for a loss as Ceres does: replaces r (rows) and J (rows x columns,
/// row-major) by those of the corrected problem, given rho, rho', rho'' at ||r||^2. rho' must be
/// positive wherever rho'' is.
void CorrectWithCeres(const double* rho, int rows, int columns, double* residual, double* jacobian);

/// rho(s), s = ||r||^2, with its transition at ||r|| = `scale` pixels; nullptr for the trivial
/// loss, which Ceres then skips.
std::unique_ptr<ceres::LossFunction> MakeLoss(LossType type, double scale);

}  // namespace bundle
