#pragma once

/// A factor: a residual of some variables, with its Jacobians and a loss.
///
/// A problem's cost is the sum of 1/2 rho(||r||^2) over its factors. Residuals are whitened: for a
/// measurement with information Omega and error e, r^T r = e^T Omega e (Whitening). Jacobians are
/// by the tangent coordinates of each variable's manifold (geometry/retraction.h), so that a factor
/// does not depend on how a solver stores its variables.

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/factors/loss.h"
#include "core/geometry/retraction.h"

namespace bundle {

/// Base class of factors.
struct FactorHead {
  std::string name;         ///< name in messages about the factor and its variables
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
  /// One per variable: the manifold that the factor expects.
  const std::vector<Retraction>& retractions() const { return retractions_; }
  int num_residuals() const { return num_residuals_; }
  /// Number of independent measurements, for degrees of freedom.
  virtual int num_measurements() const { return num_residuals_; }

  /// Computes the residual at `values`, one pointer per variable, and its Jacobians, row-major,
  /// num_residuals x tangent size. `jacobians` and each of its entries may be nullptr. Returns
  /// false if the residual has no value. May throw; a solve then ends and rethrows the exception.
  virtual bool Evaluate(const double* const* values, double* residual,
                        double* const* jacobians) const = 0;

  /// False if Evaluate must not run on two threads at the same time.
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

/// Whitening: with information Omega = L L^T (Cholesky), a residual e and its Jacobian J become
/// L^T e and L^T J, so that squared norms are e^T Omega e and normal equations J^T Omega J.
class Whitening {
 public:
  /// Reads n x n numbers, row-major. Throws InputError, beginning with `subject`, unless they are
  /// finite, symmetric and positive definite. Pivots are compared with their diagonal entries, so
  /// that coordinates may have any units.
  Whitening(const std::string& subject, std::vector<double> information, int n);

  int size() const { return n_; }
  /// m <- L^T m, n x columns, row-major.
  void Apply(double* m, int columns) const;
  /// Whitens the residual, and each requested Jacobian with its number of `columns`.
  void Apply(double* residual, double* const* jacobians, const std::vector<int>& columns) const;

 private:
  int n_;
  std::vector<double> upper_;  ///< L^T, row-major
};

/// Throws InputError, beginning with `subject`, unless an n x n matrix is finite and symmetric.
void CheckSymmetric(const std::string& subject, const std::vector<double>& matrix, int n);

/// "1.5", "-6.2e+06": a number in a message.
std::string ShortNumber(double value);

/// Returns the value as the manifold stores it, with quaternions of norm 1. Throws InputError,
/// beginning with `subject`, if it has another size, is not finite, or its quaternion is zero.
inline std::vector<double> CheckedValue(const std::string& subject, const Retraction& retraction,
                                        std::vector<double> value) {
  if (static_cast<int>(value.size()) != retraction.ambient_size()) {
    throw InputError(subject + ": expected " + std::to_string(retraction.ambient_size()) +
                     " numbers (" + retraction.name() + "), found " + std::to_string(value.size()));
  }
  for (size_t i = 0; i < value.size(); ++i) {
    if (std::isfinite(value[i])) continue;
    throw InputError(subject + ": expected finite numbers, found " + std::to_string(value[i]) +
                     " at [" + std::to_string(i) + "]");
  }
  if (!retraction.Normalize(value.data())) {
    throw InputError(subject + ": expected a quaternion (qx qy qz qw), found one of norm 0");
  }
  return value;
}

}  // namespace bundle
