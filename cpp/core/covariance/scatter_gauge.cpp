#include "core/covariance/scatter_gauge.h"

#include <cstddef>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using LongMatrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

/// A dense symmetric matrix of which the lower triangle is stored.
LongMatrix Whole(const std::vector<double>& values, Eigen::Index n) {
  LongMatrix whole = Eigen::Map<const Eigen::MatrixXd>(values.data(), n, n).cast<long double>();
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index i = 0; i < j; ++i) whole(i, j) = whole(j, i);
  }
  return whole;
}

/// An orthonormal basis of the columns, to the digits of long doubles: what Cholesky's factor of
/// their squares leaves, Newton's iteration takes off.
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

/// S^+ of columns, and D, with residuals in long doubles.
class LongSolver {
 public:
  LongSolver(ReducedSystem* system, LongMatrix held, LongMatrix basis)
      : system_(system), held_(std::move(held)), basis_(std::move(basis)) {}

  /// S^+ b
  LongMatrix Solve(LongMatrix b) {
    constexpr int kRefinements = 3;
    RemoveGauge(&b);
    LongMatrix x = LongMatrix::Zero(b.rows(), b.cols());
    for (int k = 0; k <= kRefinements && IsFine(); ++k) {
      ThrowIfInterrupted();
      const Eigen::MatrixXd rest = (b - held_.lazyProduct(x)).cast<double>();
      Eigen::MatrixXd step = Eigen::MatrixXd::Zero(b.rows(), b.cols());
      solution = system_->Solve(rest.data(), static_cast<int>(b.cols()), step.data());
      x += step.cast<long double>();
    }
    RemoveGauge(&x);
    return x;
  }

  bool IsFine() const { return solution.status == LinearSolution::Status::kSuccess; }

  LinearSolution solution;

 private:
  void RemoveGauge(LongMatrix* x) const {
    const LongMatrix along = basis_.transpose().lazyProduct(*x);
    *x -= basis_.lazyProduct(along);
  }

  ReducedSystem* const system_;
  const LongMatrix held_, basis_;
};

void Store(const LongMatrix& matrix, std::vector<double>* values) {
  values->resize(static_cast<size_t>(matrix.size()));
  Eigen::Map<Eigen::MatrixXd>(values->data(), matrix.rows(), matrix.cols()) = matrix.cast<double>();
}

}  // namespace

ScatterGauge::ScatterGauge(const FreeGauge& gauge)
    : gauge_(gauge),
      basis_(OrthonormalColumns(gauge.cameras())),
      e_(Eigen::MatrixXd::Zero(gauge.cameras().rows(), gauge.degrees())),
      q_(Eigen::MatrixXd::Zero(gauge.degrees(), gauge.degrees())) {}

void ScatterGauge::AddPoint(int point, const PointBlocks& blocks, const ParameterLayout& layout,
                            const double* e, const double p[9]) {
  const PointRows n =
      Eigen::Map<const Matrix3>(blocks.inverse).lazyProduct(gauge_.OfPoint(point));  // V^-1 N_p
  const PointRows pn = Eigen::Map<const Matrix3>(p).lazyProduct(n);
  q_ += n.transpose().lazyProduct(pn);
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const CameraBlock& block = layout.blocks()[blocks.blocks[b]];
    for (int k = 0; k < block.size; ++k) {
      const double* const row = e + 3 * size_t(blocks.begin[b] + k);
      e_.row(block.offset + k) += row[0] * n.row(0) + row[1] * n.row(1) + row[2] * n.row(2);
    }
  }
}

Eigen::MatrixXd ScatterGauge::UnitColumns(int first, int columns) const {
  Eigen::MatrixXd y = -basis_ * basis_.middleRows(first, columns).transpose();
  for (int c = 0; c < columns; ++c) y(first + c, c) += 1;
  return y;
}

void ScatterGauge::RemoveGauge(Eigen::Ref<Eigen::MatrixXd> x) const {
  x -= Multiply(basis_, MultiplyTransposed(basis_, x));
}

LinearSolution ScatterGauge::Finish(ReducedSystem* system, const std::vector<double>& meat) {
  const int d = gauge_.degrees();
  LinearSolution solution;
  // to = S^+ from, or C from.
  const auto solve = [&](Eigen::MatrixXd from, bool without_gauge, Eigen::MatrixXd* to) {
    if (solution.status != LinearSolution::Status::kSuccess) return;
    if (without_gauge) RemoveGauge(from);
    to->setZero(from.rows(), d);
    solution = system->Solve(from.data(), d, to->data());
    if (without_gauge) RemoveGauge(*to);
  };
  solve(basis_, false, &solved_basis_);
  solve(gauge_.reduced(), true, &x_);
  if (solution.status != LinearSolution::Status::kSuccess) return solution;
  SymmetricProduct product(system->structure(), system->num_threads());
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(x_.rows(), d);
  for (int m = 0; m < d; ++m) product.Multiply(meat, x_.col(m).data(), right.col(m).data());
  right += e_;
  solve(std::move(right), true, &of_unknowns_);
  of_rest_ = q_ + MultiplyTransposed(gauge_.reduced(), of_unknowns_) + MultiplyTransposed(e_, x_);
  return solution;
}

LinearSolution ScatterGauge::FinishDense(ReducedSystem* system, const std::vector<double>& held,
                                         const std::vector<double>& meat,
                                         std::vector<double>* scatter,
                                         std::vector<double>* inverse) {
  const Eigen::Index n = basis_.rows();
  LongSolver solver(system, Whole(held, n), LongOrthonormal(gauge_.cameras()));
  const LongMatrix b = Whole(meat, n), k = gauge_.reduced().cast<long double>(),
                   e = e_.cast<long double>();
  const LongMatrix whole_inverse = solver.Solve(LongMatrix::Identity(n, n));
  const LongMatrix x = solver.Solve(k);
  const LongMatrix r = solver.Solve(e + b.lazyProduct(x));
  Store(whole_inverse, inverse);
  Store(solver.Solve(b.lazyProduct(whole_inverse)), scatter);
  x_ = x.cast<double>();
  of_unknowns_ = r.cast<double>();
  const LongMatrix rest = k.transpose().lazyProduct(r) + e.transpose().lazyProduct(x);
  of_rest_ = q_ + rest.cast<double>();
  return solver.solution;
}

void ScatterGauge::TransformInverse(const BlockStructure& structure,
                                    std::vector<double>* values) const {
  TransformBlocks(basis_, solved_basis_, MultiplyTransposed(basis_, solved_basis_), structure,
                  values);
}

void ScatterGauge::TransformScatter(const BlockStructure& structure,
                                    std::vector<double>* values) const {
  TransformBlocks(gauge_.cameras(), of_unknowns_, of_rest_, structure, values);
}

void ScatterGauge::TransformPoint(int point, const PointBlocks& blocks,
                                  const ParameterLayout& layout, const double* e, const double p[9],
                                  double* covariance) const {
  const Eigen::Map<const Matrix3> inverse(blocks.inverse);
  const PointRows n = gauge_.OfPoint(point);
  const PointRows solved = inverse.lazyProduct(n);
  PointRows sum = Eigen::Map<const Matrix3>(p).lazyProduct(solved);  // P V^-1 N_p + E_p^T X
  PointRows by_y = PointRows::Zero(3, n.cols());                     // Y^T R
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const CameraBlock& block = layout.blocks()[blocks.blocks[b]];
    for (int k = 0; k < block.size; ++k) {
      const size_t at = 3 * size_t(blocks.begin[b] + k);
      for (int i = 0; i < 3; ++i) {
        sum.row(i) += e[at + i] * x_.row(block.offset + k);
        by_y.row(i) += blocks.y[at + i] * of_unknowns_.row(block.offset + k);
      }
    }
  }
  const PointRows r = inverse.lazyProduct(sum) - by_y;
  const PointRows nt = n.lazyProduct(of_rest_);
  Eigen::Map<Matrix3> to(covariance);
  to += nt.lazyProduct(n.transpose()) - r.lazyProduct(n.transpose()) - n.lazyProduct(r.transpose());
}

}  // namespace bundle
