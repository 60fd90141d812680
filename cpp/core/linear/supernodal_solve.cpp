/// Part of SupernodalCholesky (supernodal_cholesky.h): triangular solves.
///
/// L y = b goes through the panels in order: a panel solves its own rows by its diagonal block, and
/// subtracts the products of its rows below from theirs. L^T x = y goes back, with sums over the
/// rows below. These rows are first gathered into one vector.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/linear/supernodal_cholesky.h"
#include "core/parallel/blas.h"

namespace bundle {

void SupernodalCholesky::Solve(const double* values, double* x, int num_rhs) {
  if (num_rhs == 1) return SolveOne(values, x);
  SolveMany(values, x, num_rhs);
}

void SupernodalCholesky::SolveOne(const double* values, double* x) {
  std::vector<double>& product = scratch_.front().product;
  product.resize(std::max(product.size(), static_cast<size_t>(offset_.back())));
  double* const below = product.data();
  const auto for_rows = [&](int s, const auto& visit) {
    for (int64_t e = supernodes_.rows_begin[s]; e < supernodes_.rows_begin[s + 1]; ++e) {
      double* const at = below + supernodes_.row_in_panel[e] - Width(s);
      visit(at, x + offset_[supernodes_.row_block[e]], BlockSize(e));
    }
  };
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    const int height = supernodes_.height[s];
    kernels_.forward(values + supernodes_.values_begin[s], height, height, Width(s),
                     x + FirstColumn(s), below);
    for_rows(s, [](const double* from, double* to, int size) {
      for (int i = 0; i < size; ++i) to[i] -= from[i];
    });
  }
  for (int s = supernodes_.num_panels() - 1; s >= 0; --s) {
    const int height = supernodes_.height[s];
    for_rows(s, [](double* to, const double* from, int size) {
      for (int i = 0; i < size; ++i) to[i] = from[i];
    });
    kernels_.backward(values + supernodes_.values_begin[s], height, height, Width(s),
                      x + FirstColumn(s), below);
  }
}

void SupernodalCholesky::SolveMany(const double* values, double* x, int num_rhs) {
  constexpr char kLeft = 'L', kLower = 'L', kPlain = 'N', kTransposed = 'T', kNonUnit = 'N';
  constexpr double kMinusOne = -1, kZero = 0, kOne = 1;
  const int n = offset_.back();
  std::vector<double>& product = scratch_.front().product;
  product.resize(std::max(product.size(), static_cast<size_t>(n) * num_rhs));
  double* const below = product.data();
  // Gathers the rows of X that panel s has below its own columns.
  const auto for_rows = [&](int s, int rows, const auto& visit) {
    for (int k = 0; k < num_rhs; ++k) {
      double* at = below + static_cast<int64_t>(k) * rows;
      double* const column = x + static_cast<int64_t>(k) * n;
      for (int64_t e = supernodes_.rows_begin[s]; e < supernodes_.rows_begin[s + 1]; ++e) {
        const int size = BlockSize(e);
        visit(at, column + offset_[supernodes_.row_block[e]], size);
        at += size;
      }
    }
  };
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    dtrsm_(&kLeft, &kLower, &kPlain, &kNonUnit, &width, &num_rhs, &kOne, panel, &height, own, &n);
    if (rows == 0) continue;
    dgemm_(&kPlain, &kPlain, &rows, &num_rhs, &width, &kOne, panel + width, &height, own, &n,
           &kZero, below, &rows);
    for_rows(s, rows, [](const double* from, double* to, int size) {
      for (int i = 0; i < size; ++i) to[i] -= from[i];
    });
  }
  for (int s = supernodes_.num_panels() - 1; s >= 0; --s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    if (rows > 0) {
      for_rows(s, rows,
               [](double* to, const double* from, int size) { std::copy_n(from, size, to); });
      dgemm_(&kTransposed, &kPlain, &width, &num_rhs, &rows, &kMinusOne, panel + width, &height,
             below, &rows, &kOne, own, &n);
    }
    dtrsm_(&kLeft, &kLower, &kTransposed, &kNonUnit, &width, &num_rhs, &kOne, panel, &height, own,
           &n);
  }
}

}  // namespace bundle
