#pragma once

#include <memory>

#include "core/fused/reduced/reduced_system.h"
#include "core/fused/reduced/symmetric_product.h"
#include "core/solve/options.h"

namespace bundle::fused {

/// z = M^-1 r, with M near S and easier to invert.
class Preconditioner {
 public:
  virtual ~Preconditioner() = default;

  /// Prepares for a system. False if M is not positive definite.
  virtual bool Update(const ReducedSystem& system, const std::vector<double>& scale) = 0;

  virtual void Multiply(const double* r, double* z) = 0;

  virtual bool NeedsCameraDiagonal() const { return false; }
  virtual bool NeedsSimilarities() const { return false; }
  /// Of the forcing term that conjugate gradients stop by.
  virtual double ForcingFactor() const { return 1; }
};

/// `preconditioner` is one of kIdentity, kJacobi, kSchurJacobi, kSchurPowerSeriesExpansion and
/// kTwoLevel.
/// Keeps references to the structure and the product.
std::unique_ptr<Preconditioner> MakePreconditioner(PreconditionerType preconditioner,
                                                   const ReducedStructure& structure,
                                                   SymmetricProduct* product, int num_threads);

}  // namespace bundle::fused
