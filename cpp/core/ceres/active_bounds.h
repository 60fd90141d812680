#pragma once

/// Numbers of a state that stand on a bound beyond which the cost falls, for Ceres.
///
/// model/parameter_layout.h (StateBounds) says why these are active and stay where they are. Ceres
/// does not know active bounds. It asks for derivatives at each new state, and before that we find
/// the active numbers by the gradient; then costs have no derivatives by them, so that no step
/// moves them and the model expects nothing of it.

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "core/model/parameter_layout.h"

namespace bundle {

class ActiveBounds {
 public:
  /// `state` is where Ceres evaluates; it outlives this.
  ActiveBounds(StateBounds bounds, const double* state)
      : bounds_(std::move(bounds)), state_(state), is_active_(bounds_.lower.size()) {}

  const StateBounds& bounds() const { return bounds_; }

  /// The cost without derivatives by active numbers; itself where there are no bounds. `blocks`: of
  /// parameters, those of the state among them. `loss` may be nullptr.
  std::unique_ptr<ceres::CostFunction> Wrap(std::unique_ptr<ceres::CostFunction> cost,
                                            const ceres::LossFunction* loss,
                                            std::vector<double*> blocks) {
    if (bounds_.empty()) return cost;
    auto wrapped = std::make_unique<Cost>(std::move(cost), loss, std::move(blocks), *this);
    costs_.push_back(wrapped.get());
    return wrapped;
  }

  /// Finds the active numbers at the state. Takes an evaluation of the costs that depend on numbers
  /// on their bounds.
  void Find() {
    const size_t n = is_active_.size();
    std::fill(is_active_.begin(), is_active_.end(), 0);
    std::vector<uint8_t> on_bound(n);
    for (size_t j = 0; j < n; ++j) on_bound[j] = bounds_.IsOn(j, state_[j]);
    if (std::count(on_bound.begin(), on_bound.end(), 1) == 0) return;
    std::vector<double> gradient(n);
    for (const Cost* cost : costs_) cost->AddGradient(on_bound, &gradient);
    for (size_t j = 0; j < n; ++j) is_active_[j] = bounds_.IsActive(j, state_[j], gradient[j]);
  }

 private:
  class Cost final : public ceres::CostFunction {
   public:
    Cost(std::unique_ptr<ceres::CostFunction> cost, const ceres::LossFunction* loss,
         std::vector<double*> blocks, const ActiveBounds& active)
        : cost_(std::move(cost)), loss_(loss), blocks_(std::move(blocks)), active_(active) {
      set_num_residuals(cost_->num_residuals());
      *mutable_parameter_block_sizes() = cost_->parameter_block_sizes();
      const double* const end = active.state_ + active.is_active_.size();
      for (const double* block : blocks_) {
        const bool is_of_state = !std::less<>()(block, active.state_) && std::less<>()(block, end);
        offsets_.push_back(is_of_state ? block - active.state_ : -1);
      }
    }

    bool Evaluate(double const* const* parameters, double* residuals,
                  double** jacobians) const override {
      if (!cost_->Evaluate(parameters, residuals, jacobians)) return false;
      for (size_t b = 0; jacobians != nullptr && b < offsets_.size(); ++b) {
        if (jacobians[b] == nullptr || offsets_[b] < 0) continue;
        const int size = parameter_block_sizes()[b];
        for (int k = 0; k < size; ++k) {
          if (active_.is_active_[offsets_[b] + k] == 0) continue;
          for (int r = 0; r < num_residuals(); ++r) jacobians[b][r * size + k] = 0;
        }
      }
      return true;
    }

    /// Adds J^T r, corrected for the loss, by the blocks with a number on its bound.
    void AddGradient(const std::vector<uint8_t>& on_bound, std::vector<double>* gradient) const {
      for (size_t b = 0; b < offsets_.size(); ++b) {
        if (offsets_[b] < 0) continue;
        const int size = parameter_block_sizes()[b], rows = num_residuals();
        const auto first = on_bound.begin() + offsets_[b];
        if (std::count(first, first + size, 1) == 0) continue;
        std::vector<double> residual(rows), jacobian(static_cast<size_t>(rows) * size);
        std::vector<double*> jacobians(offsets_.size());
        jacobians[b] = jacobian.data();
        if (!cost_->Evaluate(blocks_.data(), residual.data(), jacobians.data())) continue;
        double rho[3] = {0, 1, 0}, squared = 0;
        for (const double r : residual) squared += r * r;
        if (loss_ != nullptr) loss_->Evaluate(squared, rho);
        for (int r = 0; r < rows; ++r) {
          for (int k = 0; k < size; ++k) {
            (*gradient)[offsets_[b] + k] += rho[1] * residual[r] * jacobian[r * size + k];
          }
        }
      }
    }

   private:
    const std::unique_ptr<ceres::CostFunction> cost_;
    const ceres::LossFunction* const loss_;
    const std::vector<double*> blocks_;
    std::vector<int64_t> offsets_;  ///< of each block in the state; -1: it is a point
    const ActiveBounds& active_;
  };

  const StateBounds bounds_;
  const double* const state_;
  std::vector<uint8_t> is_active_;
  std::vector<const Cost*> costs_;
};

}  // namespace bundle
