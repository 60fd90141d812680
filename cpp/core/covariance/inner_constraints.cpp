#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/dense/decompositions.h"

namespace bundle {

InnerConstraints::InnerConstraints(const FullVectors& directions, const FullVectors& y)
    : n_(directions), y_(y), k_(size_t(directions.num_columns) * directions.num_columns) {
  const int d = degrees();
  const auto map = [d](const std::vector<double>& v) {
    return Eigen::Map<const Eigen::MatrixXd>(v.data(), d == 0 ? 0 : Eigen::Index(v.size()) / d, d);
  };
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      k_.data(), d, d) = MultiplyTransposed(map(n_.cameras), map(y_.cameras)) +
                         MultiplyTransposed(map(n_.points), map(y_.points));
}

void InnerConstraints::RowsOfUnknowns(int first, int count, double* n, double* y) const {
  const int d = degrees();
  const size_t size = n_.cameras.size() / d;
  for (int i = 0; i < count; ++i) {
    for (int m = 0; m < d; ++m) {
      *n++ = n_.cameras[m * size + first + i];
      *y++ = y_.cameras[m * size + first + i];
    }
  }
}

void InnerConstraints::RowsOfPoint(int point, double* n, double* y) const {
  const int d = degrees();
  const size_t size = n_.points.size() / d;
  for (int i = 0; i < 3; ++i) {
    for (int m = 0; m < d; ++m) {
      *n++ = n_.points[m * size + 3 * size_t(point) + i];
      *y++ = y_.points[m * size + 3 * size_t(point) + i];
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
      yj(y_columns, columns, d), k(k_.data(), d, d);
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      block, rows, columns) += ni * (k * nj.transpose() - yj.transpose()) - yi * nj.transpose();
}

}  // namespace bundle
