#pragma once

/// Costs of the factors other than observations, per factor and per kind.

#include <cstdint>
#include <vector>

#include "core/factors/factor.h"
#include "core/interface/adjustment_problem.h"

namespace bundle {

/// Kind of a factor: a number shared by factors with the same class, number of residuals and kinds
/// of variables. It is the same in all processes of a run.
uint32_t KindOf(const Factor& factor, const AdjustmentProblem& problem);

/// The largest change of one of the costs, relative to the cost itself, or if that is larger to its
/// expectation, or to that of 100 residuals; 0 without factors. A whitened residual has an expected
/// cost of 1/2, so that a kind that fits far better than its sigmas, such as random walks, and a
/// kind of few factors, such as a weak prior, need not settle further.
double LargestRelativeChange(const std::vector<double>& before, const std::vector<double>& after,
                             const std::vector<double>& expected);

/// 1/2 rho(||r||^2) of each factor at the problem's own values; NaN if it has no value.
std::vector<double> FactorCosts(const AdjustmentProblem& problem);

/// Corrects r and J (rows x columns) of a factor for its loss, and returns the cost 1/2
/// rho(||r||^2). If `jacobian` is nullptr, the residual does not change.
double ApplyLoss(const Factor& factor, int columns, double* residual, double* jacobian);

}  // namespace bundle
