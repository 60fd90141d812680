#include "core/covariance/scatter_gauge.h"

#include <cstddef>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/linear/block_structure.h"
#include "core/linear/symmetric_product.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
}  // namespace

ScatterGauge::ScatterGauge(const FreeGauge& gauge)
    : gauge_(gauge),
      basis_(OrthonormalColumns(gauge.cameras())),
      q_(Eigen::MatrixXd::Zero(gauge.degrees(), gauge.degrees())) {}

void ScatterGauge::AddPoint(int point, const PointBlocks& blocks, const double p[9]) {
  const PointRows n =
      Eigen::Map<const Matrix3>(blocks.inverse).lazyProduct(gauge_.OfPoint(point));  // V^-1 N_p
  const PointRows pn = Eigen::Map<const Matrix3>(p).lazyProduct(n);
  q_ += n.transpose().lazyProduct(pn);
}

Eigen::MatrixXd ScatterGauge::UnitColumns(int first, int columns) const {
  Eigen::MatrixXd y = -Multiply(basis_, basis_.middleRows(first, columns).transpose());
  for (int c = 0; c < columns; ++c) y(first + c, c) += 1;
  return y;
}

void ScatterGauge::RemoveGauge(Eigen::Ref<Eigen::MatrixXd> x) const {
  x -= Multiply(basis_, MultiplyTransposed(basis_, x));
}

LinearSolution ScatterGauge::Finish(ReducedSystem* system, const BlockValues& meat) {
  const int d = gauge_.degrees();
  LinearSolution solution;
  const auto solve = [&](Eigen::MatrixXd from) {  // S^+ from
    Eigen::MatrixXd to = Eigen::MatrixXd::Zero(from.rows(), d);
    if (solution.status != LinearStatus::kSuccess) return to;
    RemoveGauge(from);
    solution = system->Solve(from.data(), d, to.data());
    RemoveGauge(to);
    return to;
  };
  const Eigen::MatrixXd x = solve(gauge_.reduced());
  SymmetricProduct product(system->structure(), system->num_threads());
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(x.rows(), d);
  for (int m = 0; m < d; ++m) product.Multiply(meat, x.col(m).data(), right.col(m).data());
  of_unknowns_ = solve(std::move(right));
  of_rest_ = q_ + MultiplyTransposed(gauge_.reduced(), of_unknowns_);
  return solution;
}

void ScatterGauge::TransformScatter(const BlockStructure& structure, BlockValues* values) const {
  TransformBlocks(gauge_.cameras(), of_unknowns_, of_rest_, structure, values);
}

void ScatterGauge::TransformPoint(int point, const PointBlocks& blocks,
                                  const ParameterLayout& layout, const double p[9],
                                  double* covariance) const {
  const Eigen::Map<const Matrix3> inverse(blocks.inverse);
  const PointRows n = gauge_.OfPoint(point);
  const PointRows solved = inverse.lazyProduct(n);
  const PointRows own = Eigen::Map<const Matrix3>(p).lazyProduct(solved);  // P V^-1 N_p
  PointRows by_y = PointRows::Zero(3, n.cols());                           // Y^T R
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const CameraBlock& block = layout.blocks()[blocks.blocks[b]];
    for (int k = 0; k < block.size; ++k) {
      const size_t at = 3 * size_t(blocks.begin[b] + k);
      for (int i = 0; i < 3; ++i) {
        by_y.row(i) += blocks.y[at + i] * of_unknowns_.row(block.offset + k);
      }
    }
  }
  const PointRows r = inverse.lazyProduct(own) - by_y;
  const PointRows nt = n.lazyProduct(of_rest_);
  Eigen::Map<Matrix3> to(covariance);
  to += nt.lazyProduct(n.transpose()) - r.lazyProduct(n.transpose()) - n.lazyProduct(r.transpose());
}

}  // namespace bundle
