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
      k_(MultiplyTransposed(gauge.reduced(), y_) + gauge.of_points()) {}

void InnerConstraints::RowsOfUnknowns(int first, int count, double* n, double* y) const {
  for (int i = 0; i < count; ++i) {
    for (int m = 0; m < degrees(); ++m) {
      *n++ = gauge_.cameras()(first + i, m);
      *y++ = y_(first + i, m);
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

void TransformBlocks(const Eigen::MatrixXd& n, const Eigen::MatrixXd& y, const Eigen::MatrixXd& k,
                     const BlockStructure& s, std::vector<double>* values) {
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Eigen::Index d = n.cols();
  // The change is left right^T: [N | -Y] of the row's block times [N k - Y | N] of the column's.
  Eigen::MatrixXd left(n.rows(), 2 * d);
  left << n, -y;
  Rows right(n.rows(), 2 * d);
  right << Multiply(n, k) - y, n;
  for (int j = 0; j < s.num_blocks(); ++j) {
    for (int64_t e = s.column_begin[j]; e < s.column_begin[j + 1]; ++e) {
      const int first = s.offset[s.row_block[e]], rows = s.block_size(s.row_block[e]);
      for (int c = 0; c < s.block_size(j); ++c) {
        double* const to = values->data() + s.ValueIndex(j, e, 0, c);
        const double* const by = right.row(s.offset[j] + c).data();
        for (Eigen::Index m = 0; m < 2 * d; ++m) {
          const double* const column = left.col(m).data() + first;
          for (int r = 0; r < rows; ++r) to[r] += by[m] * column[r];
        }
      }
    }
  }
}

}  // namespace bundle
