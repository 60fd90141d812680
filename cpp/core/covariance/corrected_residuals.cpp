/// Part of leverages.h: residuals corrected for their leverage, and the curvature of the loss.

#include <Eigen/Core>
#include <Eigen/Jacobi>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

#include "core/covariance/leverages.h"
#include "core/error.h"

namespace bundle {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;

/// Per observation, so that sums do not depend on threads.
struct Found {
  explicit Found(size_t count)
      : scores(2 * count), m(2 * count), known(count), rest(count), squares(count) {}

  std::vector<double> scores;   ///< r^
  std::vector<double> m;        ///< m, zero along full leverage
  std::vector<double> known;    ///< tr h without full leverage
  std::vector<double> rest;     ///< 2 - tr h; 0 if rho' = 0
  std::vector<double> squares;  ///< ||rho' r||^2
  std::atomic<bool> has_bends{false};
};

/// Takes the eigenvalues of h, and all that follows from them. One Jacobi rotation diagonalises a
/// symmetric matrix of two rows.
void Take(const Leverage& of, Found* found) {
  const auto i = static_cast<size_t>(of.observation);
  const Matrix2d& h = of.h;
  const double off = 0.5 * (h(0, 1) + h(1, 0));
  Eigen::JacobiRotation<double> turn;
  turn.makeJacobi(h(0, 0), off, h(1, 1));
  Matrix2d axes;
  axes << turn.c(), turn.s(), -turn.s(), turn.c();
  const double moved = off == 0 ? 0 : turn.s() / turn.c() * off;
  const Vector2d eigenvalues(h(0, 0) - moved, h(1, 1) + moved);
  const Eigen::Map<const Vector2d> r(of.residual);
  const Vector2d along = axes.transpose() * r;
  Vector2d scaled = Vector2d::Zero(), k = Vector2d::Zero();
  for (int axis = 0; axis < 2; ++axis) {
    const double own = std::max(eigenvalues[axis], 0.0), rest = 1 - own;
    if (rest <= kFullLeverage) continue;
    scaled[axis] = along[axis] / std::sqrt(rest);
    k[axis] = own / rest;
    found->known[i] += own;
  }
  Eigen::Map<Vector2d>(&found->scores[2 * i]) = axes * scaled;
  found->squares[i] = of.weight * r.squaredNorm();
  if (of.weight > 0) found->rest[i] = 2 - h.trace();
  if (of.bend != 0) found->has_bends.store(true, std::memory_order_relaxed);
  // The eigenvalues of K + bend q q^T with q = K^(1/2) r.
  const Vector2d q = k.cwiseSqrt().cwiseProduct(along);
  const double a = k[0] + of.bend * q[0] * q[0], b = of.bend * q[0] * q[1];
  const double c = k[1] + of.bend * q[1] * q[1];
  const double mean = 0.5 * (a + c), half = std::hypot(0.5 * (a - c), b);
  found->m[2 * i] = mean - half;
  found->m[2 * i + 1] = mean + half;
}

double Sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

/// sum m / (kappa + m), `flat`: of positive m only.
double Determined(const std::vector<double>& m, double kappa, bool flat) {
  double sum = 0;
  for (const double value : m) sum += flat && value < 0 ? 0 : value / (kappa + value);
  return sum;
}

/// The largest root of Determined(kappa) = known in (least, 1]; 0 if there is none. Looks for a
/// change of sign in steps of kStep, and bisects.
double LargestRoot(const std::vector<double>& m, double known, double least, bool flat) {
  constexpr double kStep = 0.95;
  double above = 1;
  if (least >= above) return 0;
  while (Determined(m, above, flat) < known) {
    const double next = kStep * above;
    if (next <= least) return 0;
    if (Determined(m, next, flat) < known) {
      above = next;
      continue;
    }
    double below = next;
    while (above - below > 1e-14) {
      const double middle = 0.5 * (above + below);
      (Determined(m, middle, flat) < known ? above : below) = middle;
    }
    return below;
  }
  return above;
}

double FindCurvature(const Found& found) {
  if (!found.has_bends) return 1;
  const double known = Sum(found.known);
  const double least = -*std::min_element(found.m.begin(), found.m.end());
  double kappa = LargestRoot(found.m, known, std::max(least, kLeastCurvature), false);
  if (kappa == 0) kappa = LargestRoot(found.m, known, kLeastCurvature, true);
  if (kappa > 0) return kappa;
  throw InputError(
      "robust: expected a loss that lets enough observations count for a sandwich, found most of "
      "them beyond its scale; use a larger loss_scale or weights");
}

}  // namespace

CorrectedResiduals CorrectForLeverage(const ReducedSystem& system, const LongMatrix& inverse) {
  Found found(static_cast<size_t>(system.problem().num_observations));
  ForLeverages(system, inverse, [&](const Leverage& of) { Take(of, &found); });
  CorrectedResiduals corrected;
  const double rest = Sum(found.rest);
  if (rest > kFullLeverage) corrected.variance = Sum(found.squares) / rest;
  corrected.kappa = FindCurvature(found);
  corrected.scores = std::move(found.scores);
  return corrected;
}

}  // namespace bundle
