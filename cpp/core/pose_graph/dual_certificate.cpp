#include "core/pose_graph/dual_certificate.h"

/// Derivation. For any symmetric Lambda = diag(Lambda_i, 0), with blocks at the rotations, and any
/// poses Z, Y_i^T Y_i = I gives
///
///   F(Z) = tr(Z Q Z^T) = tr Lambda + tr(Z S Z^T),     S = Q - Lambda.
///
/// If S + eta diag(I, 0) is positive semidefinite, then tr(Z S Z^T) >= -eta n d, and
///
///   F* >= tr Lambda - eta n d                                                              (1)
///
/// for any X from which Lambda was computed. At a critical point X S = 0 and F(X) = tr Lambda: if S
/// is positive semidefinite, X is a global optimum (Carlone, Rosen, Calafiore, Leonard, Dellaert,
/// Lagrangian duality in 3D SLAM, IROS 2015; Rosen et al., SE-Sync, IJRR 2019). The same holds for
/// a relaxation of rank r > d, whose optimum is no larger.
///
/// The smallest such eta is -lambda, with lambda the smallest eigenvalue of S with its translations
/// eliminated: S_RR - S_Rt S_tt^+ S_tR. The smallest eigenvalue of S itself gives no bound. S has
/// the null vector (0, 1) of a translation; t of the first pose is left out, so that S_tt is
/// positive definite. A Cholesky factorisation of S + eta diag(I, 0) that ends is the test:
/// for indefinite matrices no pivoting is necessary, because a pivot that is not positive ends it.
///
/// Eigenvalues. With P the rotations, P (S + eta diag(I, 0))^-1 P^T is the inverse of the
/// eliminated S plus eta. Block Lanczos (dense/krylov.cpp) finds its largest eigenvalues
/// 1 / (lambda + eta). eta is above -lambda by the factorisation, so that no eigenvalue
/// lies on the other side of the shift: a shift near 0 would find the eigenvalues nearest to 0.
/// The rows of X, which span the null space at a critical point, are projected out; a null space of
/// dimension d would hide the rest.

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "core/dense/decompositions.h"
#include "core/dense/krylov.h"

namespace bundle {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

/// Relative gap at which a point counts as optimal. Tenths of it are tried for the bound.
constexpr double kRelativeGap = 1e-6;
constexpr int kSmallerShifts = 3;
/// An edge with a cost below this share of its kappa has an error of 1e-6 rad. If all have, F is 0,
/// its bound. The sum of all kappa is no measure of that: one large weight would hide the errors of
/// all other edges.
constexpr double kExactEdges = 1e-12;
/// Long chains amplify rounding: a shift of so many times the smallest one passes if its gap is
/// this share of F.
constexpr double kMostRounding = 1e3;
constexpr double kRoundedGap = 1e-3;
/// A gap beyond this share of F is no certificate, even if the shift passes: weights that differ by
/// 1e12 raise the smallest shift above the eigenvalues of the light edges.
constexpr double kMostGap = 0.1;
/// Shifts below this share of the mean diagonal entry of S at the rotations are rounding. The error
/// E of a factorisation has |E_ij| up to about 1e-16 sqrt(S_ii S_jj), so that tr(Z E Z^T) is up to
/// about that share of the sum of these entries, as a shift of this size is in (1).
constexpr double kSmallestShift = 4e-15;
constexpr int kMostDimensions = 160;
constexpr int kMostRestarts = 20;
constexpr double kRitzResidual = 1e-9;

}  // namespace

DualCertificate::DualCertificate(const ChordalProblem& problem, const MatrixXd& point,
                                 bool explicit_form)
    : problem_(problem),
      point_(point),
      d_(problem.dimension()),
      b_(problem.block()),
      explicit_(explicit_form),
      rounding_(ChordalRounding(problem, point)),
      diagonal_(DiagonalBlocks(problem)),
      matrix_(problem.graph, problem.block(), problem.num_threads, problem.ordering) {
  cost_ = ChordalCost(problem, point, &residual_);
  const MatrixXd multipliers = Multipliers(problem, point, residual_);
  trace_ = 0;
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    const SmallMatrix lambda = multipliers.middleCols(i * d_, d_);
    trace_ += lambda.trace();
    const SmallMatrix y = point.middleCols(i * b_, d_);
    residual_.middleCols(i * b_, d_) -= y.lazyProduct(lambda);
    diagonal_.middleCols(i * b_, b_).topLeftCorner(d_, d_) -= lambda;
    const Eigen::VectorXd sizes = diagonal_.middleCols(i * b_, b_).diagonal().cwiseAbs();
    scale_ = std::max(scale_, sizes.maxCoeff());
    mean_ += sizes.head(d_).mean() / static_cast<double>(problem.num_poses());
  }
}

bool DualCertificate::Factorize(double shift) {
  matrix_.Clear();
  for (int64_t i = 0; i < problem_.num_poses(); ++i) {
    SmallMatrix block = diagonal_.middleCols(i * b_, b_);
    block.diagonal().head(explicit_ ? b_ : d_).array() += shift;
    if (i == 0 && !explicit_) {
      block.row(d_).setZero();
      block.col(d_).setZero();
      block(d_, d_) = scale_;
    }
    matrix_.AddDiagonal(i, block);
  }
  for (int64_t e = 0; e < problem_.graph.num_edges(); ++e) {
    const int64_t i = problem_.graph.edges()[2 * e], j = problem_.graph.edges()[2 * e + 1];
    SmallMatrix block = PairBlock(problem_, e);
    if (i == 0 && !explicit_) block.row(d_).setZero();
    if (j == 0 && !explicit_) block.col(d_).setZero();
    matrix_.AddPair(i, j, block);
  }
  return matrix_.Factorize();
}

DualBound DualCertificate::Bound() {
  DualBound found;
  found.trace = trace_;
  const double count = static_cast<double>(problem_.num_poses()) * d_;
  const double floor = kSmallestShift * mean_;
  const double largest = std::max({kRelativeGap * cost_ / count, floor, rounding_ / count});
  const bool is_definite = Factorize(largest);
  if (is_definite) {
    found.shift = largest;
    for (int k = 0; k < kSmallerShifts && found.shift > floor; ++k) {
      const double smaller = std::max(0.1 * found.shift, floor);
      if (!Factorize(smaller)) break;
      found.shift = smaller;
    }
  } else {
    found.shift = SmallestPositiveShift(largest);
  }
  const double gap = found.shift * count;
  const bool is_rounding = found.shift <= kMostRounding * floor && gap <= kRoundedGap * cost_;
  found.holds = (is_definite && gap <= kMostGap * cost_) || is_rounding ||
                HasExactEdges(problem_, point_, kExactEdges);
  found.bound = trace_ - found.shift * count;
  return found;
}

/// A shift within a factor of 1 + 1e-7 of the smallest eigenvalue's.
double DualCertificate::SmallestPositiveShift(double shift) {
  for (double& above = shift; !Factorize(above); above *= 10) {
    if (!(above < 1e6 * scale_)) {
      throw std::runtime_error("DualCertificate: S is not finite");
    }
  }
  double closest = shift;
  for (int round = 0; round < 4; ++round) {
    const double lambda = Spectrum(1.2 * closest, 1).eigenvalues.front();
    const double closer = -lambda * (1 + 1e-7) + kSmallestShift * mean_;
    if (!(closer < closest * (1 - 1e-6)) || !Factorize(closer)) break;
    closest = closer;
  }
  return closest;
}

DualSpectrum DualCertificate::Spectrum(double shift, int count) {
  // Far from the null space, whose directions a tiny shift would amplify.
  shift = std::max(shift, 1e-12 * scale_);
  if (!Factorize(shift)) throw std::runtime_error("DualCertificate: the shift is too small");
  const MatrixXd known = KnownNullSpace();
  const auto without_known = [&](MatrixXd vectors) {
    for (int twice = 0; twice < 2; ++twice) {
      vectors -= Multiply(known, MultiplyTransposed(known, vectors));
    }
    return vectors;
  };
  const auto apply = [&](const MatrixXd& vectors) {
    return without_known(FromUnknowns(matrix_.Solve(ToUnknowns(without_known(vectors)))));
  };
  const int size = static_cast<int>(known.rows());
  const int most = std::min<int>(kMostDimensions, size - static_cast<int>(known.cols()));
  DualSpectrum found;
  if (most > 0) {
    // Blocks as large as the number of eigenvalues find all of a multiple one.
    const int wanted = std::min(count, most);
    const EigenPairs pairs = FindLargest(size, wanted, std::max(std::min(2, most), wanted), most,
                                         kRitzResidual, apply, kMostRestarts);
    for (const double value : pairs.values) found.eigenvalues.push_back(1 / value - shift);
    if (!pairs.values.empty()) {
      const MatrixXd whole = matrix_.Solve(ToUnknowns(pairs.vectors.leftCols(1)));
      found.direction = whole / FromUnknowns(whole).norm();
    }
  }
  for (int64_t row = 0; row < point_.rows(); ++row) {
    const double quotient =
        residual_.row(row).dot(point_.row(row)) /
        std::max(FromUnknowns(point_.row(row).transpose()).squaredNorm(), 1e-300);
    found.of_rows = std::min(found.of_rows, quotient);
  }
  return found;
}

MatrixXd DualCertificate::ToUnknowns(const MatrixXd& v) const {
  if (explicit_) return v;
  MatrixXd all = MatrixXd::Zero(b_ * problem_.num_poses(), v.cols());
  for (int64_t i = 0; i < problem_.num_poses(); ++i) {
    all.middleRows(i * b_, d_) = v.middleRows(i * d_, d_);
  }
  return all;
}

MatrixXd DualCertificate::FromUnknowns(const MatrixXd& v) const {
  if (explicit_) return v;
  MatrixXd rotations(d_ * problem_.num_poses(), v.cols());
  for (int64_t i = 0; i < problem_.num_poses(); ++i) {
    rotations.middleRows(i * d_, d_) = v.middleRows(i * b_, d_);
  }
  return rotations;
}

/// Orthonormal basis of the rows of X, and in the explicit form of the translation of all poses.
MatrixXd DualCertificate::KnownNullSpace() const {
  const int64_t n = problem_.num_poses(), size = explicit_ ? b_ * n : d_ * n;
  const int64_t more = explicit_ ? 1 : 0;
  MatrixXd rows = MatrixXd::Zero(size, point_.rows() + more);
  for (int64_t k = 0; k < point_.rows(); ++k) rows.col(k) = FromUnknowns(point_.row(k).transpose());
  if (explicit_) {
    for (int64_t i = 0; i < n; ++i) rows(i * b_ + d_, point_.rows()) = 1;
  }
  // Rows that depend on others, of points whose rank is below their number of rows, are left out.
  const SymmetricEigen eigen = DecomposeSymmetric(MultiplyTransposed(rows, rows));
  const double largest = eigen.values.maxCoeff();
  int kept = 0;
  while (kept < eigen.values.size() && !(eigen.values[kept] > 1e-12 * largest)) ++kept;
  const int64_t rank = eigen.values.size() - kept;
  MatrixXd basis = Multiply(rows, eigen.vectors.rightCols(rank));
  for (int64_t k = 0; k < rank; ++k) basis.col(k).normalize();
  return basis;
}

}  // namespace bundle
