#include "core/pose_graph/rank_staircase.h"

/// Derivation (Boumal, Voroninski, Bandeira, The non-convex Burer-Monteiro approach works on smooth
/// semidefinite programs, NIPS 2016; Rosen et al., SE-Sync, IJRR 2019). A critical point X of rank
/// r with S v = lambda v in the sense of dual_certificate.cpp, lambda < 0, is a saddle of the
/// problem with r + 1 rows: at [X; alpha v^T], retracted to the manifold,
///
///   F = F(X) + lambda alpha^2 || v_R ||^2 + O(alpha^3)
///
/// because the new row is orthogonal to X, and Lambda is the curvature of the retraction. A search
/// over alpha and a minimisation at rank r + 1 follow. At a minimum whose S is positive
/// semidefinite the relaxation is solved: its cost bounds F of all poses from below.
///
/// A rank that neither lowers F nor raises its bound is the last one: in a flat valley the next
/// ranks would not either, and each is dearer. All ranks share a number of steps.
///
/// Rounding: the d rows of X with the largest singular values of [Y_1 ... Y_n], with one row
/// reflected if most blocks then have determinant -1, and each block replaced by the nearest
/// rotation. Without noise beyond the relaxation's tightness, X has rank d and nothing is lost.

#include <algorithm>

#include "core/dense/decompositions.h"
#include "core/pose_graph/chordal_newton.h"

namespace bundle {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr int kMostHalvings = 40;
constexpr int kMostSteps = 300;
/// A change of F or of its bound, as a share of F, that counts.
constexpr double kLeastChange = 1e-6;

/// [X; alpha v^T], retracted.
MatrixXd Lifted(const ChordalProblem& problem, const MatrixXd& point, const VectorXd& direction,
                double alpha) {
  const int d = problem.dimension(), b = problem.block();
  MatrixXd lifted(point.rows() + 1, point.cols());
  lifted.topRows(point.rows()) = point;
  lifted.bottomRows(1) = alpha * direction.transpose();
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    lifted.middleCols(i * b, d) = NearestOrthonormal(lifted.middleCols(i * b, d));
  }
  return lifted;
}

/// The lowest point along a direction: alpha is halved while F falls.
MatrixXd Descended(const ChordalProblem& problem, const MatrixXd& point,
                   const VectorXd& direction) {
  const int d = problem.dimension(), b = problem.block();
  double largest = 1e-300;
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    largest = std::max(largest, direction.segment(i * b, d).norm());
  }
  double best = ChordalCost(problem, point, nullptr);
  MatrixXd lowest = Lifted(problem, point, direction, 0);
  bool is_lower = false;
  double alpha = 2 / largest;
  for (int k = 0; k < kMostHalvings; ++k, alpha *= 0.5) {
    MatrixXd candidate = Lifted(problem, point, direction, alpha);
    const double cost = ChordalCost(problem, candidate, nullptr);
    if (cost < best) {
      best = cost;
      lowest.swap(candidate);
      is_lower = true;
    } else if (is_lower) {
      break;
    }
  }
  return lowest;
}

MatrixXd Rounded(const ChordalProblem& problem, const MatrixXd& point) {
  const int d = problem.dimension(), b = problem.block();
  MatrixXd gram = MatrixXd::Zero(point.rows(), point.rows());
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    const SmallMatrix y = point.middleCols(i * b, d);
    gram += y.lazyProduct(y.transpose());
  }
  const MatrixXd axes = DecomposeSymmetric(gram).vectors.rightCols(d);
  MatrixXd rounded = MultiplyTransposed(axes, point);
  int64_t num_reflected = 0;
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    if (Determinant(rounded.middleCols(i * b, d)) < 0) ++num_reflected;
  }
  if (2 * num_reflected > problem.num_poses()) rounded.row(0) *= -1;
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    rounded.middleCols(i * b, d) = NearestOrthonormal(rounded.middleCols(i * b, d), true);
  }
  return rounded;
}

}  // namespace

StaircaseOutcome ClimbStaircase(const ChordalProblem& problem, const DualBound& before,
                                MatrixXd point, VectorXd direction, int max_rank,
                                const ProgressCallback& progress) {
  StaircaseOutcome outcome;
  double cost = ChordalCost(problem, point, nullptr), bound = before.bound;
  for (int steps_left = kMostSteps;;) {
    point = Descended(problem, point, direction);
    outcome.rank = static_cast<int>(point.rows());
    const ChordalNewtonOutcome newton =
        MinimizeChordal(problem, {steps_left, false, progress}, &point);
    steps_left -= newton.num_steps;
    outcome.relaxed_cost = newton.cost;
    DualCertificate certificate(problem, point);
    outcome.relaxed_bound = certificate.Bound();
    if (outcome.relaxed_bound.holds || outcome.rank >= max_rank || steps_left <= 0) break;
    const double least = kLeastChange * cost;
    if (cost - newton.cost <= least && outcome.relaxed_bound.bound - bound <= least) break;
    cost = newton.cost;
    bound = std::max(bound, outcome.relaxed_bound.bound);
    direction = certificate.Spectrum(1.5 * outcome.relaxed_bound.shift, 1).direction;
  }
  outcome.point = Rounded(problem, point);
  return outcome;
}

}  // namespace bundle
