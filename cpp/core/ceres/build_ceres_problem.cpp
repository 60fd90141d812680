/// Part of CeresSolve (ceres_solve.h): the ceres::Problem of a bundle adjustment, with its
/// parameter blocks, bounds, observations and factors.

#include <memory>
#include <utility>
#include <vector>

#include "core/ceres/ceres_solve.h"
#include "core/ceres/losses.h"
#include "core/model/factor_costs.h"
#include "core/model/problem_factors.h"

namespace bundle {

void CeresSolve::BuildProblem() {
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;  // the layout contains every block only once
  problem_options.evaluation_callback = &update_states_;
  ceres_problem_ = std::make_unique<ceres::Problem>(problem_options);

  // In the order of memory, so that Ceres accesses parameter blocks in sequence.
  for (int p = 0; p < problem_.num_points; ++p) {
    if (layout_.point_is_free(p)) ceres_problem_->AddParameterBlock(PointData(p), 3);
  }
  for (const CameraBlock& block : layout_.blocks()) {
    ceres_problem_->AddParameterBlock(State() + block.offset, block.size);
  }
  AddBounds();
  costs_.reserve(problem_.num_observations);
  for (int64_t i = 0; i < problem_.num_observations; ++i) AddObservation(i);
  num_residuals_ = 2 * static_cast<int64_t>(costs_.size());
  if (problem_.factors == nullptr) return;
  for (const auto& factor : problem_.factors->factors) AddFactor(*factor);
}

void CeresSolve::AddFactor(const Factor& factor) {
  ChartedFactor charted(factor, problem_, layout_);
  if (charted.is_fixed()) {
    fixed_cost_ += charted.Cost(states_, nullptr);
    return;
  }
  std::vector<double*> blocks;
  for (const int point : charted.unknowns().points) blocks.push_back(PointData(point));
  for (const int block : charted.unknowns().blocks) {
    blocks.push_back(State() + layout_.blocks()[block].offset);
  }
  num_residuals_ += charted.num_residuals();
  factor_losses_.push_back(MakeLoss(factor.loss(), factor.loss_scale()));
  costs_.push_back(active_bounds_.Wrap(MakeFactorCost(std::move(charted), states_, &abandonment_),
                                       factor_losses_.back().get(), blocks));
  factor_costs_.Add(KindOf(factor, problem_), *costs_.back(), factor_losses_.back().get(), blocks);
  ceres_problem_->AddResidualBlock(costs_.back().get(), factor_losses_.back().get(), blocks);
}

void CeresSolve::AddBounds() {
  const StateBounds bounds = layout_.Bounds(problem_);
  if (bounds.empty()) return;
  const bool inexact = options_.linear_solver_type == LinearSolverType::kDenseQr;
  for (const CameraBlock& block : layout_.blocks()) {
    const auto part = [&](const std::vector<double>& of) {
      const auto first = of.begin() + block.offset;
      return std::vector<double>(first, first + block.size);
    };
    active_bounds_.Add(ceres_problem_.get(), State() + block.offset,
                       {part(bounds.lower), part(bounds.upper)}, inexact);
  }
}

void CeresSolve::AddObservation(int64_t i) {
  const int image = problem_.observation_image[i];
  const int point = problem_.observation_point[i];
  double* blocks[ParameterLayout::kNumPlaces + 1];
  int num_blocks = 0;
  if (layout_.point_is_free(point)) blocks[num_blocks++] = PointData(point);
  for (const int index : layout_.blocks_of(image)) {
    if (index >= 0) blocks[num_blocks++] = State() + layout_.blocks()[index].offset;
  }
  std::unique_ptr<ceres::CostFunction> cost = MakeReprojectionCost(context_, i);
  if (num_blocks == 0) {
    fixed_cost_ += Cost(*cost);
    return;
  }
  cost = active_bounds_.Wrap(std::move(cost), loss_.get(), {blocks, blocks + num_blocks});
  ceres_problem_->AddResidualBlock(cost.get(), loss_.get(), blocks, num_blocks);
  costs_.push_back(std::move(cost));
}

double CeresSolve::Cost(const ceres::CostFunction& cost) const {
  double residual[2];
  cost.Evaluate(nullptr, residual, nullptr);
  const double squared = residual[0] * residual[0] + residual[1] * residual[1];
  if (loss_ == nullptr) return 0.5 * squared;
  double rho[3];
  loss_->Evaluate(squared, rho);
  return 0.5 * rho[0];
}

std::vector<double> CeresSolve::StartNumbers(const AdjustmentProblem& problem,
                                             const ParameterLayout& layout) {
  const std::vector<double> state = layout.InitialState(problem);
  std::vector<double> numbers(problem.points,
                              problem.points + 3 * static_cast<int64_t>(problem.num_points));
  numbers.insert(numbers.end(), state.begin(), state.end());
  return numbers;
}

}  // namespace bundle
