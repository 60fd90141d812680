/// Part of SchurProblem (schur_problem.h): states of a solve by the cost of all observations, also
/// of those with a held residual, and the return to the best of them (LeastSquares::CostOfAll).

#include <algorithm>
#include <cstdint>
#include <memory>

#include "core/schur/schur_problem.h"

namespace bundle {

double SchurProblem::CostOfAll() {
  DoubleDouble cost;
  for (const HeldResidual& held : x_->held.all()) {
    double residual[2], rho[3];
    const bool counts = ResidualOf(held, residual);
    const double* const r = counts ? residual : held.residual;
    const double* const sigmas = input_.inverse_sigma;
    const double weight = counts && sigmas != nullptr ? sigmas[held.observation] : 1;
    ValueOfLoss(input_.loss, input_.loss_scale, weight * weight * (r[0] * r[0] + r[1] * r[1]), rho);
    cost.Add(0.5 * rho[0]);
  }
  return x_cost_ + RoundOverRanks(communicator_, cost);
}

void SchurProblem::KeepPrevious() {
  kept_ = std::make_unique<Kept>(Kept{*candidate_, candidate_cost_, candidate_held_cost_,
                                      candidate_norm_, candidate_kind_costs_});
}

void SchurProblem::ReturnToKept() {
  x_ = &kept_->state;
  x_cost_ = kept_->cost;
  x_held_cost_ = kept_->held_cost;
  state_norm_ = kept_->norm;
  kind_costs_ = kept_->kind_costs;
}

bool SchurProblem::ResidualOf(const HeldResidual& held, double* residual) const {
  const auto next = std::upper_bound(plan_.first.begin(), plan_.first.end(), held.observation);
  const int64_t point = next - plan_.first.begin() - 1;
  const int image = plan_.image[held.observation];
  const int camera = problem_.image_camera[image];
  const CameraStates& cameras = x_->cameras();
  return EvaluateReprojection(*problem_.camera_models[camera], cameras.pose(image),
                              cameras.params(camera), &x_->points[3 * point],
                              &plan_.xy[2 * held.observation], input_.cheirality, residual, nullptr,
                              cameras.shutter(image));
}

}  // namespace bundle
