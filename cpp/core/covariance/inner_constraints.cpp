#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

}  // namespace

InnerConstraints::InnerConstraints(const FreeGauge& gauge, Eigen::MatrixXd y)
    : gauge_(gauge),
      y_(std::move(y)),
      of_cameras_(MultiplyTransposed(gauge.reduced(), y_)),
      k_(of_cameras_ + gauge.of_points()) {}

void InnerConstraints::RowsOfUnknowns(int first, int count, double* n, double* y) const {
  for (int i = 0; i < count; ++i) {
    for (int m = 0; m < degrees(); ++m) {
      *n++ = gauge_.cameras()(first + i, m);
      *y++ = y_(first + i, m);
    }
  }
}

void InnerConstraints::RowsOfPoint(int point, const PointBlocks& blocks,
                                   const ParameterLayout& layout, double* n, double* y) const {
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<Rows> of_n(n, 3, degrees()), of_y(y, 3, degrees());
  of_n = gauge_.OfPoint(point);
  of_y = Eigen::Map<const Matrix3>(blocks.inverse).lazyProduct(of_n);
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const CameraBlock& block = layout.blocks()[blocks.blocks[b]];
    const double* by = &blocks.y[3 * size_t(blocks.begin[b])];
    for (int k = 0; k < block.size; ++k, by += 3) {
      for (int m = 0; m < degrees(); ++m) {
        const double x = y_(block.offset + k, m);
        for (int i = 0; i < 3; ++i) of_y(i, m) -= by[i] * x;
      }
    }
  }
}

void InnerConstraints::Transform(int rows, const double* n_rows, const double* y_rows, int columns,
                                 const double* n_columns, const double* y_columns,
                                 double* block) const {
  using Map =
      Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
  const int d = degrees();
  const Map ni(n_rows, rows, d), yi(y_rows, rows, d), nj(n_columns, columns, d),
      yj(y_columns, columns, d);
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      block, rows, columns) += ni * (k_ * nj.transpose() - yj.transpose()) - yi * nj.transpose();
}

void InnerConstraints::TransformReduced(const BlockStructure& s,
                                        std::vector<double>* values) const {
  for (int j = 0; j < s.num_blocks(); ++j) {
    const auto nj = gauge_.cameras().middleRows(s.offset[j], s.block_size(j));
    const auto yj = y_.middleRows(s.offset[j], s.block_size(j));
    const Eigen::MatrixXd by_n = (of_cameras_ * nj.transpose() - yj.transpose()).eval();
    for (int64_t e = s.column_begin[j]; e < s.column_begin[j + 1]; ++e) {
      const int i = s.row_block[e], rows = s.block_size(i);
      const Eigen::MatrixXd change = gauge_.cameras().middleRows(s.offset[i], rows) * by_n -
                                     y_.middleRows(s.offset[i], rows) * nj.transpose();
      for (int c = 0; c < s.block_size(j); ++c) {
        for (int r = 0; r < rows; ++r) (*values)[s.ValueIndex(j, e, r, c)] += change(r, c);
      }
    }
  }
}

}  // namespace bundle
