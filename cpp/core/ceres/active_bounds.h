#pragma once

/// Active bounds for Ceres: numbers of a state on a bound beyond which the cost decreases.
///
/// Ceres projects a step onto the bounds after it has computed it. It then compares the decrease of
/// the cost with the decrease of a model in which such numbers leave their bounds. If these numbers
/// have most of the gradient, the ratio is near zero. Then every step is rejected, and the solve
/// "converges" at its state (ceres-solver issue 187). Active numbers are explained in
/// model/parameter_layout.h (StateBounds).
///
/// Ceres asks for derivatives at each new state. Before that, the active numbers are determined
/// from the gradient. The derivatives of all costs w.r.t. the active numbers are then set to zero.
/// So no step moves these numbers and the model predicts no decrease from them.
///
/// DENSE_QR keeps a number without derivatives constant only up to rounding, which the small
/// damping of its row amplifies. It would leave its bound by 1e-9 and no longer be active. For
/// DENSE_QR, a manifold also holds active numbers constant.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/factors/loss.h"
#include "core/model/parameter_layout.h"

namespace bundle {

class ActiveBounds {
 public:
  /// Sets the bounds of a parameter block of the problem; Ceres evaluates at this block's memory.
  /// Call before any cost is wrapped. `inexact`: steps may move numbers without derivatives.
  void Add(ceres::Problem* problem, double* data, StateBounds bounds, bool inexact) {
    bool has_bound = false;
    for (size_t k = 0; k < bounds.lower.size(); ++k) {
      const int index = static_cast<int>(k);
      const bool has_lower = std::isfinite(bounds.lower[k]);
      const bool has_upper = std::isfinite(bounds.upper[k]);
      if (has_lower) problem->SetParameterLowerBound(data, index, bounds.lower[k]);
      if (has_upper) problem->SetParameterUpperBound(data, index, bounds.upper[k]);
      has_bound = has_bound || has_lower || has_upper;
    }
    if (!has_bound) return;
    const size_t size = bounds.lower.size();
    place_[data] = static_cast<int>(blocks_.size());
    blocks_.push_back({data, std::move(bounds), std::vector<uint8_t>(size), {}});
    if (!inexact) return;
    manifolds_.push_back(
        std::make_unique<Keep>(*this, blocks_.size() - 1, problem->GetManifold(data)));
    problem->SetManifold(data, manifolds_.back().get());
  }

  /// Returns the cost without derivatives w.r.t. active numbers, or the cost itself if none of its
  /// parameter blocks has bounds. `loss` may be nullptr and must outlive the result.
  std::unique_ptr<ceres::CostFunction> Wrap(std::unique_ptr<ceres::CostFunction> cost,
                                            const ceres::LossFunction* loss,
                                            std::vector<double*> parameters) {
    std::vector<int> places;
    for (const double* parameter : parameters) {
      const auto found = place_.find(parameter);
      places.push_back(found == place_.end() ? -1 : found->second);
    }
    if (std::all_of(places.begin(), places.end(), [](int place) { return place < 0; })) return cost;
    auto wrapped = std::make_unique<Cost>(std::move(cost), loss, std::move(parameters),
                                          std::move(places), *this);
    costs_.push_back(wrapped.get());
    return wrapped;
  }

  /// Finds the active numbers at the state. Evaluates the costs that depend on numbers on their
  /// bounds.
  void Find() {
    bool any_on_bound = false;
    for (Block& block : blocks_) {
      const size_t size = block.is_active.size();
      std::fill(block.is_active.begin(), block.is_active.end(), 0);
      block.gradient.clear();
      for (size_t k = 0; k < size; ++k) {
        if (block.bounds.IsOn(k, block.data[k])) block.gradient.assign(size, 0.0);
      }
      any_on_bound = any_on_bound || !block.gradient.empty();
    }
    if (!any_on_bound) return;
    for (const Cost* cost : costs_) cost->AddGradient(&blocks_);
    for (Block& block : blocks_) {
      for (size_t k = 0; k < block.gradient.size(); ++k) {
        block.is_active[k] = block.bounds.IsActive(k, block.data[k], block.gradient[k]);
      }
    }
  }

 private:
  struct Block {
    const double* data;
    StateBounds bounds;
    std::vector<uint8_t> is_active;
    std::vector<double> gradient;  ///< empty if no number is on its bound
  };

  class Cost final : public ceres::CostFunction {
   public:
    Cost(std::unique_ptr<ceres::CostFunction> cost, const ceres::LossFunction* loss,
         std::vector<double*> parameters, std::vector<int> places, const ActiveBounds& active)
        : cost_(std::move(cost)),
          loss_(loss),
          parameters_(std::move(parameters)),
          places_(std::move(places)),
          active_(active) {
      set_num_residuals(cost_->num_residuals());
      *mutable_parameter_block_sizes() = cost_->parameter_block_sizes();
    }

    bool Evaluate(double const* const* parameters, double* residuals,
                  double** jacobians) const override {
      if (!cost_->Evaluate(parameters, residuals, jacobians)) return false;
      for (size_t b = 0; jacobians != nullptr && b < places_.size(); ++b) {
        if (jacobians[b] == nullptr || places_[b] < 0) continue;
        const std::vector<uint8_t>& is_active = active_.blocks_[places_[b]].is_active;
        const size_t size = is_active.size();
        for (size_t k = 0; k < size; ++k) {
          if (is_active[k] == 0) continue;
          for (int r = 0; r < num_residuals(); ++r) jacobians[b][r * size + k] = 0;
        }
      }
      return true;
    }

    /// Adds J^T r, corrected for the loss, for the blocks with a number on its bound.
    void AddGradient(std::vector<Block>* blocks) const {
      for (size_t b = 0; b < places_.size(); ++b) {
        if (places_[b] < 0 || (*blocks)[places_[b]].gradient.empty()) continue;
        std::vector<double>& gradient = (*blocks)[places_[b]].gradient;
        const size_t size = gradient.size();
        const int rows = num_residuals();
        std::vector<double> residual(rows), jacobian(rows * size);
        std::vector<double*> jacobians(places_.size());
        jacobians[b] = jacobian.data();
        if (!cost_->Evaluate(parameters_.data(), residual.data(), jacobians.data())) continue;
        double rho[3] = {0, 1, 0};
        if (loss_ != nullptr) loss_->Evaluate(SquaredNorm(residual.data(), rows), rho);
        for (int r = 0; r < rows; ++r) {
          for (size_t k = 0; k < size; ++k) {
            gradient[k] += rho[1] * residual[r] * jacobian[r * size + k];
          }
        }
      }
    }

   private:
    const std::unique_ptr<ceres::CostFunction> cost_;
    const ceres::LossFunction* const loss_;
    const std::vector<double*> parameters_;
    const std::vector<int> places_;  ///< per parameter block: index in blocks_; -1: without bounds
    const ActiveBounds& active_;
  };

  /// Returns a manifold that keeps active numbers constant, or nullptr if none is needed.
  class Keep final : public ceres::Manifold {
   public:
    Keep(const ActiveBounds& active, size_t block, const ceres::Manifold* manifold)
        : active_(active),
          block_(block),
          size_(static_cast<int>(active.blocks_[block].is_active.size())),
          manifold_(manifold) {}

    int AmbientSize() const override { return size_; }
    int TangentSize() const override {
      return manifold_ != nullptr ? manifold_->TangentSize() : size_;
    }

    bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
      if (manifold_ != nullptr) {
        if (!manifold_->Plus(x, delta, x_plus_delta)) return false;
      } else {
        std::transform(x, x + size_, delta, x_plus_delta, std::plus<>());
      }
      const std::vector<uint8_t>& is_active = active_.blocks_[block_].is_active;
      for (int k = 0; k < size_; ++k) {
        if (is_active[k] != 0) x_plus_delta[k] = x[k];
      }
      return true;
    }

    bool PlusJacobian(const double* x, double* jacobian) const override {
      return manifold_ != nullptr ? manifold_->PlusJacobian(x, jacobian) : SetIdentity(jacobian);
    }

    bool Minus(const double* y, const double* x, double* y_minus_x) const override {
      if (manifold_ != nullptr) return manifold_->Minus(y, x, y_minus_x);
      std::transform(y, y + size_, x, y_minus_x, std::minus<>());
      return true;
    }

    bool MinusJacobian(const double* x, double* jacobian) const override {
      return manifold_ != nullptr ? manifold_->MinusJacobian(x, jacobian) : SetIdentity(jacobian);
    }

   private:
    bool SetIdentity(double* matrix) const {
      std::fill_n(matrix, size_ * size_, 0.0);
      for (int k = 0; k < size_; ++k) matrix[k * size_ + k] = 1;
      return true;
    }

    const ActiveBounds& active_;
    const size_t block_;
    const int size_;
    const ceres::Manifold* const manifold_;
  };

  std::vector<Block> blocks_;
  std::vector<std::unique_ptr<Keep>> manifolds_;
  std::unordered_map<const double*, int>
      place_;  ///< index in blocks_ for a parameter block's address
  std::vector<const Cost*> costs_;
};

}  // namespace bundle
