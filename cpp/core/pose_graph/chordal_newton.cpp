#include "core/pose_graph/chordal_newton.h"

/// Derivation. Y_i is on the Stiefel manifold of r x d matrices with orthonormal columns, for
/// r = d the rotations and reflections. Its tangents are Y_i A with A skew, and for r > d also
/// P_i K with P_i an orthonormal basis of the complement of Y_i. With these and the translations,
/// V_i = [Y_i A + P_i K, v] = B_i p_i has m = d (d - 1) / 2 + (r - d) d + r unknowns p_i.
///
/// With S = Q - Lambda and Lambda_i = sym(Y_i^T (X Q)_i), the Riemannian gradient and the exact
/// Hessian are (Absil, Mahony, Sepulchre, Optimization algorithms on matrix manifolds, 2008)
///
///   g_i = 2 B_i^T vec((X Q)_i),    H_ij = 2 B_i^T (S_ij kron I_r) B_j.
///
/// The multiplier Lambda is the curvature of the manifold. Without it, 2 B^T (Q kron I) B is
/// Gauss-Newton's Hessian, which is positive semidefinite. A step factorises H; if H is not
/// positive definite, it takes Gauss-Newton's with Levenberg-Marquardt damping. The retraction is
/// the nearest matrix with orthonormal columns. A candidate that raises F is rejected, and the
/// damping grows.
///
/// F is quadratic in the translations: their best values at the rotations Y follow from one linear
/// system, sum tau || t_j - t_i - Y_i t ||^2, with a matrix that depends on tau alone (variable
/// projection, Golub and Pereyra 1973). Every candidate gets them. Otherwise a long chain, which
/// swings its end with every rotation, would be limited to tiny steps.
///
/// The first pose stays, which removes the gauge. At rank r > d a subgroup of O(r) may remain free;
/// the damping covers it.
///
/// The iteration ends when the model predicts a decrease (1/2 g^T H^-1 g) below 1e-13 F, or below
/// the rounding of F. A patient one takes all its steps. Others, whose point is a means, end when
/// twenty steps together lowered F by less than 1e-6 F: flat valleys of a relaxation take hundreds.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/parallel/thread_pool.h"
#include "core/pose_graph/edge_matrix.h"

namespace bundle {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kSmallDecrease = 1e-13;
constexpr double kFirstDamping = 1e-6;
constexpr double kLeastDamping = 1e-9;
constexpr double kMostDamping = 1e10;
/// Relative damping that covers rounding of a singular Hessian.
constexpr double kTinyDamping = 1e-11;
/// The steps that are judged together, and the share of F by which they lower it at least.
constexpr size_t kStepsOfProgress = 20;
constexpr double kLeastProgress = 1e-6;

class ChordalNewton {
 public:
  ChordalNewton(const ChordalProblem& problem, MatrixXd* point)
      : problem_(problem),
        point_(*point),
        d_(problem.dimension()),
        b_(problem.block()),
        r_(static_cast<int>(point->rows())),
        m_(d_ * (d_ - 1) / 2 + (r_ - d_) * d_ + r_),
        matrix_(problem.graph, m_, problem.num_threads, problem.ordering),
        laplacian_(problem.graph, 1, problem.num_threads, problem.ordering),
        q_(DiagonalBlocks(problem)),
        rounding_(ChordalRounding(problem, *point)) {
    FactorizeLaplacian();
  }

  ChordalNewtonOutcome Run(const NewtonLimits& limits) {
    ChordalNewtonOutcome outcome;
    outcome.initial_cost = ChordalCost(problem_, point_, &product_);
    cost_ = ProjectTranslations(&point_, &product_);
    double damping = 0;
    std::vector<double> costs{cost_};
    while (outcome.num_steps < limits.max_steps && !outcome.converged) {
      Linearize();
      if (!Step(&damping, &outcome.converged)) break;
      ++outcome.num_steps;
      if (limits.progress && !limits.progress(RecordOf(outcome.num_steps, costs.back(), damping))) {
        throw Interrupted();
      }
      costs.push_back(cost_);
      if (limits.is_patient || costs.size() <= kStepsOfProgress) continue;
      if (!(cost_ < (1 - kLeastProgress) * costs[costs.size() - 1 - kStepsOfProgress])) break;
    }
    Linearize();
    outcome.is_minimum = Factorize(true, kTinyDamping);
    outcome.cost = cost_;
    return outcome;
  }

 private:
  IterationRecord RecordOf(int step, double before, double damping) const {
    IterationRecord record;
    record.iteration = step;
    record.cost = cost_;
    record.cost_change = before - cost_;
    record.gradient_max_norm = gradient_.size() == 0 ? 0 : gradient_.cwiseAbs().maxCoeff();
    record.trust_region_radius = damping > 0 ? 1 / damping : 1 / kLeastDamping;
    record.step_is_successful = true;
    return record;
  }

  /// Tangent basis of pose i, (r b) x m.
  auto Basis(int64_t i) const { return basis_.middleCols(i * m_, m_); }

  void Linearize() {
    multipliers_ = Multipliers(problem_, point_, product_);
    basis_.setZero(r_ * b_, m_ * problem_.num_poses());
    gradient_.resize(m_ * problem_.num_poses());
    for (int64_t i = 0; i < problem_.num_poses(); ++i) {
      int k = 0;
      const auto column = [&](int at) { return basis_.col(i * m_ + at); };
      const auto y = [&](int c) { return point_.col(i * b_ + c); };
      for (int a = 0; a < d_; ++a) {
        for (int c = a + 1; c < d_; ++c, ++k) {
          column(k).segment(a * r_, r_) = -y(c);
          column(k).segment(c * r_, r_) = y(a);
        }
      }
      if (r_ > d_) {
        const MatrixXd own = point_.middleCols(i * b_, d_).transpose();
        const MatrixXd vectors = DecomposeSingular(own).vectors;
        for (int p = d_; p < r_; ++p) {
          for (int c = 0; c < d_; ++c, ++k) column(k).segment(c * r_, r_) = vectors.col(p);
        }
      }
      for (int p = 0; p < r_; ++p, ++k) basis_(d_ * r_ + p, i * m_ + k) = 1;
      const Eigen::Map<const VectorXd> g(product_.col(i * b_).data(), r_ * b_);
      gradient_.segment(i * m_, m_) = 2 * Basis(i).transpose() * g;
    }
    gradient_.head(m_).setZero();
  }

  /// 2 B_i^T (S_ij kron I) B_j.
  MatrixXd HessianBlock(int64_t i, int64_t j, const SmallMatrix& s) const {
    work_.resize(r_ * b_, m_);
    for (int k = 0; k < m_; ++k) {
      const Eigen::Map<const MatrixXd> v(basis_.col(j * m_ + k).data(), r_, b_);
      Eigen::Map<MatrixXd>(work_.col(k).data(), r_, b_).noalias() = v.lazyProduct(s.transpose());
    }
    return 2 * Basis(i).transpose().lazyProduct(work_);
  }

  /// Factorises the Hessian, or Gauss-Newton's, with its diagonal multiplied by 1 + damping.
  bool Factorize(bool exact, double damping) {
    matrix_.Clear();
    for (int64_t i = 0; i < problem_.num_poses(); ++i) {
      if (i == 0) {
        matrix_.AddDiagonal(i, MatrixXd::Identity(m_, m_));
        continue;
      }
      SmallMatrix s = q_.middleCols(i * b_, b_);
      const MatrixXd whole = HessianBlock(i, i, s);
      const VectorXd added = damping * whole.diagonal();
      if (exact) s.topLeftCorner(d_, d_) -= multipliers_.middleCols(i * d_, d_);
      MatrixXd block = exact ? HessianBlock(i, i, s) : whole;
      block.diagonal() += added;
      matrix_.AddDiagonal(i, block);
    }
    for (int64_t e = 0; e < problem_.graph.num_edges(); ++e) {
      const int64_t i = problem_.graph.edges()[2 * e], j = problem_.graph.edges()[2 * e + 1];
      if (i != 0 && j != 0) matrix_.AddPair(i, j, HessianBlock(i, j, PairBlock(problem_, e)));
    }
    return matrix_.Factorize();
  }

  /// Takes a step. Returns false if every candidate raises F.
  bool Step(double* damping, bool* converged) {
    bool exact = true;
    while (*damping < kMostDamping) {
      if (!Factorize(exact, *damping)) {
        if (exact) {
          exact = false;
        } else {
          *damping = std::max(10 * *damping, kFirstDamping);
        }
        continue;
      }
      const VectorXd step = matrix_.Solve(-gradient_);
      const double decrease = -0.5 * gradient_.dot(step);
      MatrixXd candidate = Moved(step), product;
      ChordalCost(problem_, candidate, &product);
      const double cost = ProjectTranslations(&candidate, &product);
      const double limit = kSmallDecrease * cost_ + rounding_;
      if (!(cost <= cost_ + limit)) {
        // A predicted decrease that small is rounding.
        if (decrease <= limit) return *converged = true, false;
        *damping = std::max(10 * *damping, kFirstDamping);
        continue;
      }
      point_.swap(candidate);
      product_.swap(product);
      cost_ = cost;
      *converged = decrease <= limit;
      *damping = *damping < kLeastDamping ? 0 : *damping / 10;
      return true;
    }
    return false;
  }

  void FactorizeLaplacian() {
    using Scalar = Eigen::Matrix<double, 1, 1>;
    const Scalar one = Scalar::Constant(1);
    laplacian_.AddDiagonal(0, one);
    for (int64_t e = 0; e < problem_.graph.num_edges(); ++e) {
      const int64_t i = problem_.graph.edges()[2 * e], j = problem_.graph.edges()[2 * e + 1];
      const Scalar tau = Scalar::Constant(problem_.tau[e]);
      if (i != 0) laplacian_.AddDiagonal(i, tau);
      if (j != 0) laplacian_.AddDiagonal(j, tau);
      if (i != 0 && j != 0) laplacian_.AddPair(i, j, Scalar(-tau));
    }
    if (!laplacian_.Factorize()) throw std::runtime_error("chordal cost: no translations");
  }

  /// Moves the translations to their minimum; `product` is X Q, before and after. Returns F.
  double ProjectTranslations(MatrixXd* point, MatrixXd* product) {
    MatrixXd rhs(problem_.num_poses(), r_);
    for (int64_t i = 0; i < problem_.num_poses(); ++i) {
      rhs.row(i) = product->col(i * b_ + d_).transpose();
    }
    rhs.row(0).setZero();
    const MatrixXd moved = laplacian_.Solve(rhs);
    for (int64_t i = 0; i < problem_.num_poses(); ++i) {
      point->col(i * b_ + d_) -= moved.row(i).transpose();
    }
    return ChordalCost(problem_, *point, product);
  }

  MatrixXd Moved(const VectorXd& step) const {
    MatrixXd moved = point_;
    for (int64_t i = 1; i < problem_.num_poses(); ++i) {
      const VectorXd v = Basis(i).lazyProduct(step.segment(i * m_, m_));
      moved.middleCols(i * b_, b_) += Eigen::Map<const MatrixXd>(v.data(), r_, b_);
      moved.middleCols(i * b_, d_) = NearestOrthonormal(moved.middleCols(i * b_, d_));
    }
    return moved;
  }

  const ChordalProblem& problem_;
  MatrixXd& point_;
  const int d_, b_, r_, m_;
  EdgeMatrix matrix_, laplacian_;
  const MatrixXd q_;
  const double rounding_;
  double cost_ = 0;
  MatrixXd product_, multipliers_, basis_;
  VectorXd gradient_;
  mutable MatrixXd work_;
};

}  // namespace

ChordalNewtonOutcome MinimizeChordal(const ChordalProblem& problem, const NewtonLimits& limits,
                                     MatrixXd* point) {
  return ChordalNewton(problem, point).Run(limits);
}

}  // namespace bundle
