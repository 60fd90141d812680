#pragma once

/// A factor: a residual of some variables, with its Jacobians and a loss.
///
/// A problem's cost is the sum of 1/2 rho(||r||^2) over its factors. Residuals are whitened: of a
/// measurement with information Omega, r^T r = e^T Omega e for its error e (whitening.h). Jacobians
/// are by the tangent coordinates of each variable's manifold (model/retraction.h), so that a
/// factor knows nothing of how a solver stores its variables.

#include <string>
#include <utility>
#include <vector>

#include "core/model/retraction.h"
#include "core/solve/options.h"

namespace bundle {

/// What all factors have.
struct FactorHead {
  std::string name;         ///< names the factor and its variables in messages
  std::vector<int> blocks;  ///< the variables, by their places in a graph
  LossType loss = LossType::kTrivial;
  double loss_scale = 1;  ///< in sigmas: of the whitened residual's norm
};

class Factor {
 public:
  virtual ~Factor() = default;
  Factor(const Factor&) = delete;
  Factor& operator=(const Factor&) = delete;

  const std::string& name() const { return head_.name; }
  const std::vector<int>& blocks() const { return head_.blocks; }
  LossType loss() const { return head_.loss; }
  double loss_scale() const { return head_.loss_scale; }
  /// One a variable: what the factor takes each of them for.
  const std::vector<Retraction>& retractions() const { return retractions_; }
  int num_residuals() const { return num_residuals_; }

  /// The residual at `values`, one pointer a variable, and its Jacobians, row-major, num_residuals
  /// x tangent size. `jacobians` may be nullptr, as may each of them. False where the residual has
  /// no value. May throw; a solve ends then and throws the same.
  virtual bool Evaluate(const double* const* values, double* residual,
                        double* const* jacobians) const = 0;

  /// False if Evaluate must not run on two threads at once.
  virtual bool IsThreadSafe() const { return true; }

 protected:
  Factor(FactorHead head, std::vector<Retraction> retractions, int num_residuals)
      : head_(std::move(head)),
        retractions_(std::move(retractions)),
        num_residuals_(num_residuals) {}

 private:
  FactorHead head_;
  std::vector<Retraction> retractions_;
  int num_residuals_;
};

}  // namespace bundle
