#pragma once

/// Divisors of the errors of Jacobians, for each entry. An entry is wrong if it differs from its
/// reference R_ij, which is uncertain by U_ij, by more than
///
///   U_ij + t s_ij,      s_ij = min(c_j, max(u_i d_j, U_ij / t)),
///
/// with the tolerance t. c_j is the norm of column j; d_j is that norm after division of each row
/// by its unit u_i <= 1. Rows of small numbers have small units, so that rows of large ones do not
/// hide their mistakes. jacobian_deviation.py, in Python, has the same rules and derives them.

#include <bundle/check_types.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace bundle {

class EntryScales {
 public:
  EntryScales(const std::vector<CheckedPoint>& points, int num_rows, int num_columns,
              double tolerance)
      : points_(points), rows_(num_rows), columns_(num_columns) {
    const size_t num_points = points.size();
    values_.resize(num_points * rows_ * columns_);
    units_.assign(num_points * rows_, 1);
    const std::vector<double> by_column = ColumnSizes();
    for (size_t k = 0; k < num_points; ++k) FindUnits(k);
    RaiseUnits();
    const std::vector<double> in_units = ColumnSizes();
    for (size_t k = 0; k < num_points; ++k) {
      for (int i = 0; i < rows_; ++i) {
        for (int j = 0; j < columns_; ++j) {
          const double own = units_[k * rows_ + i] * in_units[k * columns_ + j];
          const double known = points[k].uncertainty[At(i, j)] / tolerance;
          values_[k * rows_ * columns_ + At(i, j)] =
              std::min(by_column[k * columns_ + j], std::max(own, known));
        }
      }
    }
  }

  /// Points x rows x columns.
  const std::vector<double>& values() const { return values_; }

 private:
  static constexpr double kFloor = 1e-3;   ///< least size, as a fraction of the usual one
  static constexpr double kAlike = 1e3;    ///< ratio of sizes up to which rows share a unit
  static constexpr double kClear = 8;      ///< doubts above which an entry tells its row's size
  static constexpr int kSweeps = 50;       ///< largest number of sweeps of the fit
  static constexpr double kSettled = 0.1;  ///< change of a logarithm that ends the fit

  size_t At(int row, int column) const { return static_cast<size_t>(row) * columns_ + column; }

  static double Median(std::vector<double> values) {
    if (values.empty()) return 0;
    std::sort(values.begin(), values.end());
    const size_t half = values.size() / 2;
    return values.size() % 2 == 1 ? values[half] : (values[half - 1] + values[half]) / 2;
  }

  /// Norms of the columns (points x columns) of the references, each row divided by its unit: at
  /// least a fraction of the column's usual norm; of a column of zeros the usual norm of the
  /// others.
  std::vector<double> ColumnSizes() const {
    std::vector<double> sizes(points_.size() * columns_), usual(columns_, 0), others;
    for (int j = 0; j < columns_; ++j) {
      std::vector<double> norms;
      for (size_t k = 0; k < points_.size(); ++k) {
        double norm = 0;
        for (int i = 0; i < rows_; ++i) {
          const double value = points_[k].reference[At(i, j)] / units_[k * rows_ + i];
          if (std::isfinite(value)) norm = std::hypot(norm, value);
        }
        sizes[k * columns_ + j] = norm;
        if (norm > 0) norms.push_back(norm);
      }
      usual[j] = Median(norms);
      if (usual[j] > 0) others.push_back(usual[j]);
    }
    for (int j = 0; j < columns_; ++j) {
      const double least = usual[j] > 0 ? kFloor * usual[j] : others.empty() ? 1 : Median(others);
      for (size_t k = 0; k < points_.size(); ++k) {
        sizes[k * columns_ + j] = std::max(sizes[k * columns_ + j], least);
      }
    }
    return sizes;
  }

  /// Logarithm of a known entry that is not zero; otherwise not a number.
  double Log(size_t k, int row, int column) const {
    const double size = std::abs(points_[k].reference[At(row, column)]);
    const bool is_known =
        std::isfinite(size) && size > 0 && size > kClear * points_[k].uncertainty[At(row, column)];
    return is_known ? std::log(size) : std::numeric_limits<double>::quiet_NaN();
  }

  /// Fits log |R_ij| by a_i + b_j, row by row and column by column. The unit is kAlike times the
  /// size of the row, relative to the largest, and at most 1.
  void FindUnits(size_t k) {
    constexpr double kNone = -std::numeric_limits<double>::infinity();
    std::vector<double> of_rows(rows_, 0), of_columns(columns_, 0);
    for (int sweep = 0; sweep < kSweeps; ++sweep) {
      double moved = 0;
      for (int j = 0; j < columns_; ++j) {
        of_columns[j] = Mean(rows_, [&](int i) { return Log(k, i, j) - of_rows[i]; });
      }
      for (int i = 0; i < rows_; ++i) {
        const double before = of_rows[i];
        of_rows[i] = Mean(columns_, [&](int j) { return Log(k, i, j) - of_columns[j]; });
        moved = std::max(moved, std::abs(of_rows[i] - before));
      }
      if (moved < kSettled) break;
    }
    double largest = kNone;
    for (int i = 0; i < rows_; ++i) {
      if (IsKnown(k, i)) largest = std::max(largest, of_rows[i]);
    }
    for (int i = 0; i < rows_; ++i) {
      if (!IsKnown(k, i)) continue;
      units_[k * rows_ + i] = std::min(1.0, kAlike * std::exp(of_rows[i] - largest));
    }
  }

  /// Mean of the numbers among n values; 0 without any.
  template <typename Value>
  static double Mean(int n, const Value& value) {
    double sum = 0;
    int count = 0;
    for (int i = 0; i < n; ++i) {
      const double found = value(i);
      if (std::isnan(found)) continue;
      sum += found;
      ++count;
    }
    return count > 0 ? sum / count : 0;
  }

  bool IsKnown(size_t k, int row) const {
    for (int j = 0; j < columns_; ++j) {
      if (!std::isnan(Log(k, row, j))) return true;
    }
    return false;
  }

  void RaiseUnits() {
    for (int i = 0; i < rows_; ++i) {
      std::vector<double> units;
      for (size_t k = 0; k < points_.size(); ++k) units.push_back(units_[k * rows_ + i]);
      const double least = kFloor * Median(units);
      for (size_t k = 0; k < points_.size(); ++k) {
        units_[k * rows_ + i] = std::max(units_[k * rows_ + i], least);
      }
    }
  }

  const std::vector<CheckedPoint>& points_;
  const int rows_, columns_;
  std::vector<double> units_;  ///< points x rows
  std::vector<double> values_;
};

}  // namespace bundle
