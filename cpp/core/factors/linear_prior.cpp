#include "core/factors/linear_prior.h"

/// A dense quadratic prior on several variables, from marginalisation:
///
///   1/2 d^T Lambda d - eta^T d,        d = (Log(X_1*^-1 X_1), Log(X_2*^-1 X_2), ...),
///
/// about linearization points X*, with Lambda symmetric and positive semidefinite: free gauge
/// directions stay free. For a residual, a square root is needed. With D = diag(Lambda)^(1/2),
/// which makes it independent of units, and the eigenvalues and eigenvectors of D^-1 Lambda D^-1 =
/// V S V^T,
///
///   A = S^(1/2) V^T D,        b = S^(-1/2) V^T D^-1 eta        give
///   A^T A = Lambda,           A^T b = eta,
///
/// where only eigenvalues above rounding are kept, one residual each:
///
///   r = A d - b,        1/2 ||r||^2 = 1/2 d^T Lambda d - eta^T d + 1/2 ||b||^2,
///
/// and dr/dX_k = A_k J_r(d_k)^-1. The constant makes the minimum cost 0. eta must not have a
/// component along a direction that Lambda leaves free: the cost would have no minimum.

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/factors/factor.h"

namespace bundle {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Maximum share of eta outside the range of Lambda, both scaled: rounding errors of their
/// computation.
constexpr double kOutsideRange = 1e-6;

/// Most negative allowed eigenvalue of the scaled Lambda, relative to the largest, for the same
/// reason.
constexpr double kNegative = 1e-9;

int TotalTangentSize(const std::vector<Retraction>& retractions) {
  int total = 0;
  for (const Retraction& retraction : retractions) total += retraction.tangent_size();
  return total;
}

}  // namespace

LinearPrior::Root LinearPrior::SquareRoot(const std::string& subject, int n,
                                          const std::vector<double>& lambda,
                                          const std::vector<double>& eta) {
  CheckSymmetric(subject + ": Lambda", lambda, n);
  CheckedValue(subject + ": eta", Retraction(Manifold::kEuclidean, n), eta);
  const auto given = Eigen::Map<const RowMajor>(lambda.data(), n, n);
  Eigen::VectorXd scale(n);
  for (int i = 0; i < n; ++i) scale[i] = given(i, i) > 0 ? std::sqrt(given(i, i)) : 1;
  const Eigen::VectorXd inverse_scale = scale.cwiseInverse();
  const RowMajor scaled =
      inverse_scale.asDiagonal() * (0.5 * (given + given.transpose())) * inverse_scale.asDiagonal();
  const auto [eigenvalues, eigenvectors] = DecomposeSymmetric(scaled);
  const double largest = eigenvalues[n - 1];
  const double rounding = 16 * n * std::numeric_limits<double>::epsilon() * std::abs(largest);
  if (eigenvalues[0] < -kNegative * std::abs(largest)) {
    throw InputError(subject +
                     ": Lambda: expected a positive semidefinite matrix, found scaled "
                     "eigenvalues from " +
                     ShortNumber(eigenvalues[0]) + " to " + ShortNumber(largest));
  }
  int num_free = 0;
  while (num_free < n && eigenvalues[num_free] <= rounding) ++num_free;
  if (num_free == n) throw InputError(subject + ": Lambda: expected some information, found zeros");

  const Eigen::VectorXd turned =
      eigenvectors.transpose() *
      (inverse_scale.asDiagonal() * Eigen::Map<const Eigen::VectorXd>(eta.data(), n));
  if (turned.head(num_free).norm() > kOutsideRange * turned.norm()) {
    throw InputError(subject +
                     ": eta: expected 0 in the null space of Lambda, found a part of norm " +
                     ShortNumber(turned.head(num_free).norm()) + ", with eta of norm " +
                     ShortNumber(turned.norm()));
  }
  Root root;
  root.rows = n - num_free;
  root.a.resize(static_cast<size_t>(root.rows) * n);
  root.b.resize(root.rows);
  for (int r = 0; r < root.rows; ++r) {
    const double root_of_eigenvalue = std::sqrt(eigenvalues[num_free + r]);
    for (int c = 0; c < n; ++c) {
      root.a[r * n + c] = root_of_eigenvalue * eigenvectors(c, num_free + r) * scale[c];
    }
    root.b[r] = turned[num_free + r] / root_of_eigenvalue;
  }
  return root;
}

LinearPrior::LinearPrior(FactorHead head, std::vector<Retraction> retractions,
                         std::vector<std::vector<double>> linearization_point,
                         const std::vector<double>& lambda, const std::vector<double>& eta)
    : LinearPrior(head, retractions, std::move(linearization_point),
                  SquareRoot(head.name, TotalTangentSize(retractions), lambda, eta)) {}

LinearPrior::LinearPrior(FactorHead head, std::vector<Retraction> retractions,
                         std::vector<std::vector<double>> linearization_point, Root root)
    : Factor(std::move(head), std::move(retractions), root.rows),
      linearization_point_(std::move(linearization_point)),
      root_(std::move(root)) {
  for (size_t b = 0; b < this->retractions().size(); ++b) {
    linearization_point_[b] = CheckedValue(name() + ": linearization_point", this->retractions()[b],
                                           linearization_point_[b]);
  }
}

bool LinearPrior::Evaluate(const double* const* values, double* residual,
                           double* const* jacobians) const {
  const int rows = num_residuals();
  const int n = static_cast<int>(root_.a.size()) / rows;
  for (int r = 0; r < rows; ++r) residual[r] = -root_.b[r];
  std::vector<double> delta, inverse;
  int first = 0;
  for (size_t b = 0; b < retractions().size(); ++b) {
    const Retraction& retraction = retractions()[b];
    const int size = retraction.tangent_size();
    delta.resize(size);
    retraction.Local(linearization_point_[b].data(), values[b], delta.data());
    for (int r = 0; r < rows; ++r) {
      for (int k = 0; k < size; ++k) residual[r] += root_.a[r * n + first + k] * delta[k];
    }
    if (jacobians != nullptr && jacobians[b] != nullptr) {
      inverse.resize(size * size);
      retraction.InverseRightJacobian(delta.data(), inverse.data());
      for (int r = 0; r < rows; ++r) {
        for (int c = 0; c < size; ++c) {
          double sum = 0;
          for (int k = 0; k < size; ++k) sum += root_.a[r * n + first + k] * inverse[k * size + c];
          jacobians[b][r * size + c] = sum;
        }
      }
    }
    first += size;
  }
  return true;
}

}  // namespace bundle
