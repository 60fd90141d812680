#include "core/factors/factor.h"

#include <Eigen/Core>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/error.h"

namespace bundle {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Tolerance for two entries that should be equal, relative to the diagonal's.
constexpr double kAsymmetry = 1e-9;

[[noreturn]] void RefuseIndefinite(const std::string& subject, const std::vector<double>& matrix,
                                   int n) {
  const Eigen::VectorXd eigenvalues =
      DecomposeSymmetric(Eigen::Map<const RowMajor>(matrix.data(), n, n)).values;
  throw InputError(subject + ": expected a positive definite matrix, found eigenvalues from " +
                   ShortNumber(eigenvalues.minCoeff()) + " to " +
                   ShortNumber(eigenvalues.maxCoeff()));
}

}  // namespace

std::string ShortNumber(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

namespace {

/// Both numbers with enough digits to distinguish them.
std::pair<std::string, std::string> DistinctNumbers(double one, double other) {
  char texts[2][32];
  for (int digits = 6; digits <= 17; ++digits) {
    std::snprintf(texts[0], sizeof texts[0], "%.*g", digits, one);
    std::snprintf(texts[1], sizeof texts[1], "%.*g", digits, other);
    if (std::string(texts[0]) != texts[1]) break;
  }
  return {texts[0], texts[1]};
}

}  // namespace

void CheckSymmetric(const std::string& subject, const std::vector<double>& matrix, int n) {
  if (static_cast<int>(matrix.size()) != n * n) {
    throw InputError(subject + ": expected " + std::to_string(n) + " x " + std::to_string(n) +
                     " numbers, found " + std::to_string(matrix.size()));
  }
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < n; ++c) {
      const double one = matrix[r * n + c], other = matrix[c * n + r];
      const std::string place = "[" + std::to_string(r) + "][" + std::to_string(c) + "]";
      if (!std::isfinite(one)) {
        throw InputError(subject + ": expected finite numbers, found " + ShortNumber(one) + " at " +
                         place);
      }
      const double scale = std::sqrt(std::abs(matrix[r * n + r] * matrix[c * n + c]));
      if (std::isfinite(other) &&
          !(std::abs(one - other) <=
            kAsymmetry * std::max({scale, std::abs(one), std::abs(other)}))) {
        const auto [here, there] = DistinctNumbers(one, other);
        throw InputError(subject + ": expected a symmetric matrix, found " + here + " at " + place +
                         " and " + there + " across the diagonal");
      }
    }
  }
}

Whitening::Whitening(const std::string& subject, std::vector<double> information, int n)
    : n_(n), upper_(std::move(information)) {
  CheckSymmetric(subject, upper_, n);
  const std::vector<double> given = upper_;
  // Row k of U = L^T, with U^T U the matrix: U_kk^2 is what the rows above leave of A_kk.
  for (int k = 0; k < n; ++k) {
    for (int c = k; c < n; ++c) {
      double rest = given[k * n + c];
      for (int i = 0; i < k; ++i) rest -= upper_[i * n + k] * upper_[i * n + c];
      if (c > k) {
        upper_[k * n + c] = rest / upper_[k * n + k];
        continue;
      }
      const double rounding = 8 * n * std::numeric_limits<double>::epsilon() * given[k * n + k];
      if (!(rest > rounding) || !std::isfinite(rest)) RefuseIndefinite(subject, given, n);
      upper_[k * n + k] = std::sqrt(rest);
    }
    for (int c = 0; c < k; ++c) upper_[k * n + c] = 0;
  }
}

void Whitening::Apply(double* m, int columns) const {
  for (int r = 0; r < n_; ++r) {  // in place: row r needs rows from r on
    double* row = m + r * columns;
    for (int c = 0; c < columns; ++c) row[c] *= upper_[r * n_ + r];
    for (int k = r + 1; k < n_; ++k) {
      const double factor = upper_[r * n_ + k];
      for (int c = 0; c < columns; ++c) row[c] += factor * m[k * columns + c];
    }
  }
}

void Whitening::Apply(double* residual, double* const* jacobians,
                      const std::vector<int>& columns) const {
  Apply(residual, 1);
  if (jacobians == nullptr) return;
  for (size_t b = 0; b < columns.size(); ++b) {
    if (jacobians[b] != nullptr) Apply(jacobians[b], columns[b]);
  }
}

}  // namespace bundle
