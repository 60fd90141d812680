#include "core/covariance/scatter_gauge.h"

#include <cstddef>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

}  // namespace

ScatterGauge::ScatterGauge(const FreeGauge& gauge)
    : gauge_(gauge),
      e_(Eigen::MatrixXd::Zero(gauge.cameras().rows(), gauge.degrees())),
      q_(Eigen::MatrixXd::Zero(gauge.degrees(), gauge.degrees())) {}

void ScatterGauge::AddPoint(int point, const PointBlocks& blocks, const ParameterLayout& layout,
                            const double* e, const double p[9]) {
  const FreeGauge::PointRows n =
      Eigen::Map<const Matrix3>(blocks.inverse).lazyProduct(gauge_.OfPoint(point));  // V^-1 N_p
  const FreeGauge::PointRows pn = Eigen::Map<const Matrix3>(p).lazyProduct(n);
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
  Eigen::MatrixXd y = -gauge_.reduced() * gauge_.cameras().middleRows(first, columns).transpose();
  for (int c = 0; c < columns; ++c) y(first + c, c) += 1;
  return y;
}

void ScatterGauge::RemoveGauge(Eigen::Ref<Eigen::MatrixXd> x) const {
  x -= Multiply(gauge_.cameras(), MultiplyTransposed(gauge_.reduced(), x));
}

void ScatterGauge::AddCrossTerms(int first, Eigen::Ref<Eigen::MatrixXd> product) const {
  product -= e_ * gauge_.cameras().middleRows(first, product.cols()).transpose();
  product -= Multiply(gauge_.reduced(), MultiplyTransposed(gauge_.cameras(), product));
}

void ScatterGauge::RemoveGauge(int first, const Eigen::Ref<const Eigen::MatrixXd>& x,
                               Eigen::Ref<Eigen::MatrixXd> w) const {
  const auto n = gauge_.cameras().middleRows(first, w.cols());
  w -= Multiply(gauge_.cameras(), MultiplyTransposed(gauge_.reduced(), w) +
                                      MultiplyTransposed(e_, x) - q_ * n.transpose());
}

}  // namespace bundle
