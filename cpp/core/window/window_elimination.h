#pragma once

/// The elimination of marginalize_window.h, in double or single precision. The rows of the absorbed
/// factors are computed in double precision, everything after in `Scalar`.

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Householder>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/error.h"
#include "core/window/marginalize_window.h"
#include "core/window/window_prior.h"
#include "core/window/window_rows.h"

namespace bundle {

/// Places of the blocks among the columns: eliminated blocks, then kept blocks.
struct ColumnsOfBlocks {
  std::vector<int> at;    ///< first column of a block; -1: not in any row, or constant
  std::vector<int> kept;  ///< kept blocks, ascending
  int num_gone = 0, num_kept = 0;

  int total() const { return num_gone + num_kept; }
};

template <typename Scalar>
class WindowElimination {
  using Matrix = Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>;
  using Vector = Eigen::Matrix<Scalar, Eigen::Dynamic, 1>;
  static constexpr int kPoint = 3, kDepth = 2;  ///< numbers of a landmark; the last is its depth

 public:
  WindowElimination(const WindowView& view, const Marginalization& request,
                    const ColumnsOfBlocks& columns, const WindowRows& rows, const WindowState& at)
      : view_(view), request_(request), columns_(columns), rows_(rows), at_(at) {}

  /// Prior about the current state.
  void Run(MarginalizedWindow* result) {
    if (request_.square_root) {
      ByQr(result);
    } else {
      ByCholesky(result);
    }
  }

 private:
  void ByCholesky(MarginalizedWindow* result) {
    const int n = columns_.total(), a = columns_.num_gone, b = columns_.num_kept;
    h_ = Matrix::Zero(n, n);
    g_ = Vector::Zero(n);
    for (size_t k = 0; k < rows_.priors.size(); ++k) AddPriorForm(view_.priors[k], rows_.priors[k]);
    Scalar constant = static_cast<Scalar>(rows_.costs.Total());
    for (const InertialRows& row : rows_.inertial) AddRows(DenseInertial(row), InertialBlocks(row));
    for (size_t k = 0, anchor = 0; k < rows_.visual.size(); ++anchor) {
      const std::vector<int> blocks = BlocksOfLandmark(k);
      const Matrix dense = DenseLandmark(&k, blocks, rows_.anchors[anchor]);
      if (!(dense.col(kDepth).squaredNorm() > 0)) {
        ++result->num_landmarks_without_depth;
        continue;
      }
      const auto own = dense.leftCols(kPoint), rest = dense.rightCols(dense.cols() - kPoint);
      const Eigen::Matrix<Scalar, kPoint, kPoint> h = own.transpose() * own;
      const Eigen::LLT<Eigen::Matrix<Scalar, kPoint, kPoint>> llt(h);
      if (llt.info() != Eigen::Success) {
        ++result->num_landmarks_without_depth;
        continue;
      }
      ++result->num_landmarks;
      Matrix w = MultiplyTransposed(own, rest);  // L w = own^T rest; its last column: L^-1 g
      const auto l = llt.matrixLLT();
      w.row(0) /= l(0, 0);
      w.row(1) = (w.row(1) - l(1, 0) * w.row(0)) / l(1, 1);
      w.row(2) = (w.row(2) - l(2, 0) * w.row(0) - l(2, 1) * w.row(1)) / l(2, 2);
      Scatter(MultiplyTransposed(rest, rest) - MultiplyTransposed(w, w), blocks);
      constant -= w.col(w.cols() - 1).squaredNorm() / 2;
    }
    const Matrix haa = h_.topLeftCorner(a, a), hba = h_.bottomLeftCorner(b, a);
    Matrix solved(a, b + 1);  // H_aa^-1 [H_ab g_a]
    Matrix rhs(a, b + 1);
    rhs << h_.topRightCorner(a, b), g_.head(a);
    SolveGone(haa, rhs, &solved, result);
    Matrix lambda = h_.bottomRightCorner(b, b) - Multiply(hba, solved.leftCols(b));
    const Vector eta = Multiply(hba, solved.col(b)) - g_.tail(b);
    constant -= g_.head(a).dot(solved.col(b)) / 2;
    const double largest = b == 0 ? 0 : double(lambda.cwiseAbs().maxCoeff());
    if (largest > 0) {
      result->asymmetry = double((lambda - lambda.transpose()).cwiseAbs().maxCoeff()) / largest;
    }
    lambda = Scalar(0.5) * (lambda + lambda.transpose()).eval();
    WindowPrior& prior = result->prior;
    prior.is_square_root = false;
    prior.num_rows = b;
    for (int r = 0; r < b; ++r) {
      for (int c = 0; c < b; ++c) prior.matrix.push_back(lambda(r, c));
    }
    prior.vector.assign(eta.data(), eta.data() + b);
    prior.constant = constant;
  }

  void ByQr(MarginalizedWindow* result) {
    const int n = columns_.total(), a = columns_.num_gone, b = columns_.num_kept;
    std::vector<Matrix> parts;  // n + 1 columns each
    for (size_t k = 0; k < view_.priors.size(); ++k) parts.push_back(RowsOfOnePrior(k));
    for (const InertialRows& row : rows_.inertial) {
      parts.push_back(Spread(DenseInertial(row), InertialBlocks(row)));
    }
    for (size_t k = 0, anchor = 0; k < rows_.visual.size(); ++anchor) {
      const std::vector<int> blocks = BlocksOfLandmark(k);
      Matrix dense = DenseLandmark(&k, blocks, rows_.anchors[anchor]);
      if (!(dense.col(kDepth).squaredNorm() > 0)) {
        ++result->num_landmarks_without_depth;
        continue;
      }
      ++result->num_landmarks;
      Vector workspace(dense.cols());
      for (int c = 0; c < kPoint; ++c) {  // one Householder reflection for each of its own columns
        auto rest = dense.bottomRightCorner(dense.rows() - c, dense.cols() - c);
        Vector essential(rest.rows() - 1);
        Scalar tau, beta;
        rest.col(0).makeHouseholder(essential, tau, beta);
        rest.rightCols(rest.cols() - 1).applyHouseholderOnTheLeft(essential, tau, workspace.data());
      }
      const auto rows = dense.rows() - kPoint, columns = dense.cols() - kPoint;
      parts.push_back(Spread(dense.bottomRightCorner(rows, columns), blocks));
    }
    int num_rows = 0;
    for (const Matrix& part : parts) num_rows += static_cast<int>(part.rows());
    Matrix all(std::max(num_rows, n + 1), n + 1);
    all.setZero();
    int row = 0;
    for (const Matrix& part : parts) {
      all.middleRows(row, part.rows()) = part;
      row += static_cast<int>(part.rows());
    }
    const Matrix triangle = TriangleOfQr(all);
    Scalar largest = 0;
    for (int k = 0; k < a; ++k) largest = std::max(largest, std::abs(triangle(k, k)));
    for (int k = 0; k < a; ++k) {
      const Scalar least = std::numeric_limits<Scalar>::epsilon() * Scalar(n) * largest;
      if (!(std::abs(triangle(k, k)) > least)) result->is_regular = false;
    }
    WindowPrior& prior = result->prior;
    prior.is_square_root = true;
    prior.num_rows = b;
    for (int k = a; k < n; ++k) {
      for (int c = a; c < n; ++c) prior.matrix.push_back(triangle(k, c));
      prior.vector.push_back(triangle(k, n));
    }
    // The constant, which no step of the kept coordinates changes.
    prior.constant = 0.5 * double(triangle(n, n)) * double(triangle(n, n));
  }

  void SolveGone(const Matrix& haa, const Matrix& rhs, Matrix* solved, MarginalizedWindow* result) {
    if (SolveByCholesky(haa, rhs, solved)) return;
    // H_aa has information on some coordinates only; the others are dropped.
    result->is_regular = false;
    *solved = SolveSemidefinite(haa.template cast<double>(), rhs.template cast<double>(),
                                double(std::numeric_limits<Scalar>::epsilon()))
                  .template cast<Scalar>();
  }

  void AddPriorForm(const WindowPrior& prior, const PriorForm& form) {
    const std::vector<int> at = ColumnsOfPrior(prior);
    const size_t n = at.size();
    for (size_t r = 0; r < n; ++r) {
      if (at[r] < 0) continue;
      g_[at[r]] += static_cast<Scalar>(form.gradient[r]);
      for (size_t c = 0; c < n; ++c) {
        if (at[c] >= 0) h_(at[r], at[c]) += static_cast<Scalar>(form.information[r * n + c]);
      }
    }
  }

  /// The column of each coordinate of a prior; -1 for constant ones.
  std::vector<int> ColumnsOfPrior(const WindowPrior& prior) const {
    std::vector<int> at;
    for (const int block : prior.blocks) {
      for (int k = 0; k < PriorBlockSize(block, view_.num_states); ++k) {
        at.push_back(columns_.at[block] < 0 ? -1 : columns_.at[block] + k);
      }
    }
    return at;
  }

  Matrix RowsOfOnePrior(size_t k) const {
    const WindowPrior& prior = view_.priors[k];
    if (!prior.is_square_root) {
      throw InputError("prior: expected a square root, since its window keeps square roots");
    }
    std::vector<double> jacobian, residual;
    RowsOfPrior(view_, prior, at_, &jacobian, &residual);
    const std::vector<int> at = ColumnsOfPrior(prior);
    Matrix out = Matrix::Zero(prior.num_rows, columns_.total() + 1);
    for (int r = 0; r < prior.num_rows; ++r) {
      for (size_t c = 0; c < at.size(); ++c) {
        if (at[c] >= 0) out(r, at[c]) = static_cast<Scalar>(jacobian[r * at.size() + c]);
      }
      out(r, columns_.total()) = static_cast<Scalar>(residual[r]);
    }
    return out;
  }

  static std::vector<int> InertialBlocks(const InertialRows& row) {
    return {2 * row.first, 2 * row.first + 1, 2 * row.first + 2, 2 * row.first + 3};
  }

  static Matrix DenseInertial(const InertialRows& row) {
    constexpr int kRows = InertialRows::kRows;
    Matrix out(kRows, 2 * kStateTangent + 1);
    for (int r = 0; r < kRows; ++r) {
      for (int c = 0; c < kStateTangent; ++c) {
        out(r, c) = static_cast<Scalar>(row.by_first[r * kStateTangent + c]);
        out(r, kStateTangent + c) = static_cast<Scalar>(row.by_second[r * kStateTangent + c]);
      }
      out(r, 2 * kStateTangent) = static_cast<Scalar>(row.r[r]);
    }
    return out;
  }

  /// Sorted blocks that the rows of a landmark depend on; k is the first of these rows.
  std::vector<int> BlocksOfLandmark(size_t k) const {
    const VisualRows& first = rows_.visual[k];
    std::vector<int> blocks = {2 * first.anchor};
    for (; k < rows_.visual.size() && rows_.visual[k].landmark == first.landmark; ++k) {
      blocks.push_back(2 * rows_.visual[k].observer);
    }
    for (const int b : {view_.camera_block(), view_.time_block()}) {
      if (view_.BlockSize(b) > 0) blocks.push_back(b);
    }
    std::sort(blocks.begin(), blocks.end());
    blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
    return blocks;
  }

  /// Rows of a landmark: derivatives w.r.t. its three numbers, derivatives w.r.t. the blocks, and
  /// r. The rows of the anchoring image are last.
  Matrix DenseLandmark(size_t* k, const std::vector<int>& blocks, const AnchorRows& anchor) const {
    const int landmark = rows_.visual[*k].landmark;
    size_t end = *k;
    while (end < rows_.visual.size() && rows_.visual[end].landmark == landmark) ++end;
    std::vector<int> begin = {kPoint};
    for (const int b : blocks) begin.push_back(begin.back() + view_.BlockSize(b));
    const auto column = [&](int b) {
      return begin[std::lower_bound(blocks.begin(), blocks.end(), b) - blocks.begin()];
    };
    Matrix out = Matrix::Zero(static_cast<int>(2 * (end - *k) + 2), begin.back() + 1);
    const auto last = out.rows() - 2;
    for (int r = 0; r < 2; ++r) {
      out(last + r, r) = static_cast<Scalar>(anchor.scale);
      out(last + r, begin.back()) = static_cast<Scalar>(anchor.r[r]);
    }
    for (int row = 0; *k < end; ++*k, row += 2) {
      const VisualRows& visual = rows_.visual[*k];
      const auto put = [&](int block, const double* by) {
        const int size = view_.BlockSize(block);
        for (int r = 0; r < 2; ++r) {
          for (int c = 0; c < size; ++c) {
            out(row + r, column(block) + c) += static_cast<Scalar>(by[r * size + c]);
          }
        }
      };
      put(2 * visual.anchor, visual.by.by_anchor);
      put(2 * visual.observer, visual.by.by_observer);
      if (view_.refine_camera) put(view_.camera_block(), visual.by.by_camera);
      if (view_.refine_time_offset) put(view_.time_block(), visual.by.by_time);
      for (int r = 0; r < 2; ++r) {
        for (int c = 0; c < kPoint; ++c) {
          out(row + r, c) = static_cast<Scalar>(visual.by.by_point[kPoint * r + c]);
        }
        out(row + r, begin.back()) = static_cast<Scalar>(visual.r[r]);
      }
    }
    return out;
  }

  /// H and g of rows [by blocks, r].
  void AddRows(const Matrix& dense, const std::vector<int>& blocks) {
    Scatter(MultiplyTransposed(dense, dense), blocks);
  }

  /// Adds [J^T J, J^T r; r^T J, .] of some blocks to H and g.
  void Scatter(const Matrix& information, const std::vector<int>& blocks) {
    const int last = static_cast<int>(information.cols()) - 1;
    int row = 0;
    for (const int a : blocks) {
      const int at_a = columns_.at[a], size_a = view_.BlockSize(a);
      if (at_a >= 0) g_.segment(at_a, size_a) += information.col(last).segment(row, size_a);
      int column = 0;
      for (const int b : blocks) {
        const int at_b = columns_.at[b], size_b = view_.BlockSize(b);
        if (at_a >= 0 && at_b >= 0) {
          h_.block(at_a, at_b, size_a, size_b) += information.block(row, column, size_a, size_b);
        }
        column += size_b;
      }
      row += size_a;
    }
  }

  /// Spreads rows with the columns [`blocks`, r] to all columns of the window; others are zero.
  Matrix Spread(const Matrix& dense, const std::vector<int>& blocks) const {
    Matrix out = Matrix::Zero(dense.rows(), columns_.total() + 1);
    int column = 0;
    for (const int b : blocks) {
      const int size = view_.BlockSize(b);
      if (columns_.at[b] >= 0) {
        out.middleCols(columns_.at[b], size) = dense.middleCols(column, size);
      }
      column += size;
    }
    out.col(columns_.total()) = dense.col(dense.cols() - 1);
    return out;
  }

  const WindowView& view_;
  const Marginalization& request_;
  const ColumnsOfBlocks& columns_;
  const WindowRows& rows_;
  const WindowState& at_;
  Matrix h_;
  Vector g_;
};

}  // namespace bundle
