#pragma once

/// Whitening: with information Omega = L L^T (Cholesky), a residual e and its Jacobian J become
/// L^T e and L^T J, so that squared norms are e^T Omega e and normal equations J^T Omega J.

#include <string>
#include <vector>

namespace bundle {

class Whitening {
 public:
  /// From n x n numbers, row-major. Throws InputError, beginning with `subject`, unless they are
  /// finite, symmetric and positive definite. Pivots are judged beside their diagonal entries:
  /// coordinates may have any units.
  Whitening(const std::string& subject, std::vector<double> information, int n);

  int size() const { return n_; }
  /// m <- L^T m, n x columns, row-major.
  void Apply(double* m, int columns) const;
  /// The residual, and each Jacobian of `columns` entries a row that is wanted.
  void Apply(double* residual, double* const* jacobians, const std::vector<int>& columns) const;

 private:
  int n_;
  std::vector<double> upper_;  ///< L^T, row-major
};

/// Throws InputError, beginning with `subject`, unless an n x n matrix is finite and symmetric.
void CheckSymmetric(const std::string& subject, const std::vector<double>& matrix, int n);

/// "1.5", "-6.2e+06": a number in a message.
std::string ShortNumber(double value);

}  // namespace bundle
