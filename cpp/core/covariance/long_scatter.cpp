#include "core/covariance/long_scatter.h"

#include <cstddef>
#include <utility>

#include "core/covariance/sandwich.h"
#include "core/dense/decompositions.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

/// Orthonormal basis of the columns, to the precision of long doubles: by the Cholesky factor of
/// their Gram matrix, refined by Newton's iteration.
LongMatrix LongOrthonormal(const Eigen::MatrixXd& columns) {
  const Eigen::MatrixXd squares = MultiplyTransposed(columns, columns);
  const LongMatrix root = InverseOfCholesky(squares).cast<long double>();
  LongMatrix basis = columns.cast<long double>().lazyProduct(root);
  for (int k = 0; k < 4; ++k) {
    const LongMatrix gram = basis.transpose().lazyProduct(basis);
    const LongMatrix step = 1.5L * LongMatrix::Identity(gram.rows(), gram.cols()) - 0.5L * gram;
    basis = basis.lazyProduct(step).eval();
  }
  return basis;
}

/// The rows of a matrix for the unknowns of a point's blocks.
LongMatrix Rows(const LongMatrix& of, const std::vector<int>& unknowns) {
  LongMatrix rows(static_cast<Eigen::Index>(unknowns.size()), of.cols());
  for (Eigen::Index i = 0; i < rows.rows(); ++i) rows.row(i) = of.row(unknowns[i]);
  return rows;
}

LongMatrix Symmetric(const LongMatrix& whole) { return 0.5L * (whole + whole.transpose()); }

using Columns3 = Eigen::Matrix<long double, Eigen::Dynamic, 3>;

/// Product of these rows and columns of a symmetric matrix with `right`.
Columns3 BlockTimes(const LongMatrix& whole, const std::vector<int>& unknowns,
                    const LongMatrix& right) {
  Columns3 product(right.rows(), 3);
  for (Eigen::Index a = 0; a < right.rows(); ++a) {
    const auto column = whole.col(unknowns[a]);
    long double sum[3] = {};
    for (Eigen::Index b = 0; b < right.rows(); ++b) {
      const long double value = column[unknowns[b]];
      for (int k = 0; k < 3; ++k) sum[k] += value * right(b, k);
    }
    for (int k = 0; k < 3; ++k) product(a, k) = sum[k];
  }
  return product;
}

}  // namespace

/// Terms of the formulas of a point.
struct LongScatter::Shares {
  std::vector<int> unknowns;  ///< unknowns of its blocks
  LongMatrix y;               ///< Y, unknowns x 3
  LongMatrix inverse;         ///< V^-1
  LongMatrix p;               ///< P
  LongMatrix n;               ///< N_p, 3 x d
};

LongScatter::LongScatter(const ReducedSystem& system, LongMatrix lower, const LongMatrix& meat,
                         double variance, const FreeGauge* gauge)
    : system_(system), gauge_(gauge), lower_(std::move(lower)), variance_(variance) {
  const Eigen::Index n = lower_.rows(), d = gauge == nullptr ? 0 : gauge->degrees();
  basis_ = cameras_ = reduced_ = LongMatrix::Zero(n, d);
  if (d > 0) {
    basis_ = LongOrthonormal(gauge->cameras());
    cameras_ = gauge->cameras().cast<long double>();
    reduced_ = gauge->reduced().cast<long double>();
  }
  SumPoints();
  const LongMatrix inverse = Symmetric(Solve(LongMatrix::Identity(n, n)));
  scatter_ = Symmetric(Solve(meat.lazyProduct(inverse)));
  of_unknowns_ = Solve(meat.lazyProduct(Solve(reduced_)));
  of_rest_ = q_ + reduced_.transpose().lazyProduct(of_unknowns_);
}

/// S^+ b
LongMatrix LongScatter::Solve(LongMatrix b) const {
  ThrowIfInterrupted();
  RemoveGauge(&b);
  SolveLong(lower_, &b);
  RemoveGauge(&b);
  return b;
}

void LongScatter::RemoveGauge(LongMatrix* x) const {
  const LongMatrix along = basis_.transpose().lazyProduct(*x);
  *x -= basis_.lazyProduct(along);
}

LongScatter::Shares LongScatter::FindShares(int point, const PointBlocks& blocks,
                                            const PointAssembler& rows) const {
  const std::vector<double>& prior = system_.tracks().prior;
  double p[9];
  ExpectScatter(rows, variance_, prior.empty() ? nullptr : &prior[9 * size_t(point)], p);
  Shares shares;
  shares.unknowns = UnknownsOf(system_.layout(), blocks);
  shares.y = Eigen::Map<const Eigen::MatrixXd>(blocks.y.data(), 3, blocks.begin.back())
                 .transpose()
                 .cast<long double>();
  shares.inverse = Eigen::Map<const Eigen::Matrix3d>(blocks.inverse).cast<long double>();
  shares.p = Eigen::Map<const Eigen::Matrix3d>(p).cast<long double>();
  shares.n = LongMatrix::Zero(3, basis_.cols());
  if (basis_.cols() > 0) shares.n = gauge_->OfPoint(point).cast<long double>();
  return shares;
}

void LongScatter::SumPoints() {
  q_ = LongMatrix::Zero(basis_.cols(), basis_.cols());
  if (basis_.cols() == 0) return;
  system_.ForPoints(1, [&](int point, const PointBlocks& blocks, const PointAssembler& rows, int) {
    const Shares of = FindShares(point, blocks, rows);
    const LongMatrix solved = of.inverse.lazyProduct(of.n);
    q_ += solved.transpose().lazyProduct(of.p.lazyProduct(solved).eval());
  });
}

BlockValues LongScatter::OfUnknowns() const {
  const LongMatrix half = cameras_.lazyProduct(of_rest_.transpose()) - of_unknowns_;
  const Eigen::MatrixXd whole = (scatter_ + half.lazyProduct(cameras_.transpose()) -
                                 cameras_.lazyProduct(of_unknowns_.transpose()))
                                    .cast<double>();
  return {whole.data(), whole.data() + whole.size()};
}

void LongScatter::OfPoint(int point, const PointBlocks& blocks, const PointAssembler& rows,
                          double covariance[9]) const {
  const Shares of = FindShares(point, blocks, rows);
  const LongMatrix yt = of.y.transpose();
  LongMatrix sum = of.inverse.lazyProduct(of.p.lazyProduct(of.inverse).eval());
  sum += yt.lazyProduct(BlockTimes(scatter_, of.unknowns, of.y));
  const LongMatrix own = of.p.lazyProduct(of.inverse.lazyProduct(of.n).eval());
  const LongMatrix r =
      of.inverse.lazyProduct(own) - yt.lazyProduct(Rows(of_unknowns_, of.unknowns));
  const LongMatrix back = r.lazyProduct(of.n.transpose());
  sum += of.n.lazyProduct(of_rest_.lazyProduct(of.n.transpose()).eval()) - back - back.transpose();
  Eigen::Map<Eigen::Matrix3d> to(covariance);
  to = sum.cast<double>();
}

}  // namespace bundle
