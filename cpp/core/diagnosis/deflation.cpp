#include "core/diagnosis/deflation.h"

#include <algorithm>
#include <numeric>

#include "core/dense/decompositions.h"
#include "core/dense/krylov.h"

namespace bundle {

Deflation::Deflation(std::vector<int> piece, const Eigen::MatrixXd& directions)
    : of_pieces_(Eigen::MatrixXd::Zero(directions.rows(), directions.cols())),
      others_(directions.rows(), 0) {
  for (size_t j = 0; j < piece.size(); ++j) {
    if (piece[j] < 0) continue;
    if (piece[j] >= static_cast<int>(rows_.size())) rows_.resize(piece[j] + 1);
    rows_[piece[j]].push_back(static_cast<int>(j));
  }
  for (size_t p = 0; p < rows_.size(); ++p) {
    const Eigen::MatrixXd own = RowsOf(static_cast<int>(p), directions);
    const Eigen::MatrixXd basis = Orthonormalize(Eigen::MatrixXd(own.rows(), 0), own);
    of_pieces_(rows_[p], Eigen::seqN(0, basis.cols())) = basis;
    counts_.push_back(static_cast<int>(basis.cols()));
  }
}

void Deflation::KeepNull(const Eigen::MatrixXd& product, double tolerance) {
  for (size_t p = 0; p < rows_.size(); ++p) {
    const Eigen::MatrixXd basis = of_pieces_(rows_[p], Eigen::seqN(0, counts_[p]));
    const Eigen::MatrixXd energy =
        MultiplyTransposed(basis, product(rows_[p], Eigen::seqN(0, counts_[p])));
    of_pieces_(rows_[p], Eigen::all).setZero();
    if (counts_[p] == 0) continue;
    const SymmetricEigen pairs = DecomposeSymmetric(0.5 * (energy + energy.transpose()));
    const auto kept = (pairs.values.array() <= tolerance).count();
    if (kept > 0) {
      of_pieces_(rows_[p], Eigen::seqN(0, kept)) = Multiply(basis, pairs.vectors.leftCols(kept));
    }
    counts_[p] = static_cast<int>(kept);
  }
}

void Deflation::Add(const Eigen::MatrixXd& directions) {
  const Eigen::Index before = others_.cols();
  others_.conservativeResize(Eigen::NoChange, before + directions.cols());
  others_.rightCols(directions.cols()) = directions;
}

int Deflation::count() const {
  return std::accumulate(counts_.begin(), counts_.end(), static_cast<int>(others_.cols()));
}

Eigen::MatrixXd Deflation::Project(Eigen::MatrixXd x) const {
  for (int twice = 0; twice < 2; ++twice) {
    for (size_t p = 0; p < rows_.size(); ++p) {
      if (counts_[p] == 0) continue;
      const Eigen::MatrixXd basis = of_pieces_(rows_[p], Eigen::seqN(0, counts_[p]));
      const Eigen::MatrixXd own = RowsOf(static_cast<int>(p), x);
      x(rows_[p], Eigen::all) = own - Multiply(basis, MultiplyTransposed(basis, own));
    }
    if (others_.cols() > 0) x -= Multiply(others_, MultiplyTransposed(others_, x));
  }
  return x;
}

Eigen::MatrixXd Deflation::Dense() const {
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(of_pieces_.rows(), count());
  Eigen::Index next = 0;
  for (size_t p = 0; p < rows_.size(); ++p) {
    all(rows_[p], Eigen::seqN(next, counts_[p])) = of_pieces_(rows_[p], Eigen::seqN(0, counts_[p]));
    next += counts_[p];
  }
  all.rightCols(others_.cols()) = others_;
  return all;
}

}  // namespace bundle
