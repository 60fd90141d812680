/// Part of WindowProblem (window_problem.h): elimination of the landmarks, three unknowns each, by
/// Cholesky factors of their 3 x 3 blocks. The formulas are in window_problem.h.

#include <algorithm>
#include <cmath>

#include "core/minimize/damping.h"
#include "core/window/block_products.h"
#include "core/window/window_problem.h"

namespace bundle {

/// Adds the rows' contribution to W, H and g.
void WindowProblem::AddLandmark(const VisualRows& row, Landmark* landmark) {
  const double* const p = row.by.by_point;
  int entry = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j) landmark->hessian[entry++] += p[i] * p[j] + p[3 + i] * p[3 + j];
    landmark->gradient[i] += p[i] * row.r[0] + p[3 + i] * row.r[1];
  }
  const int blocks[] = {2 * row.anchor, 2 * row.observer, view_.camera_block(), view_.time_block()};
  const double* const by[] = {row.by.by_anchor, row.by.by_observer, row.by.by_camera,
                              row.by.by_time};
  for (int a = 0; a < 4; ++a) {
    const int n = view_.BlockSize(blocks[a]);
    if (n == 0) continue;
    int& at = touched_at_[blocks[a]];
    if (at < 0) {
      at = static_cast<int>(w_.size());
      touched_.push_back(blocks[a]);
      w_.resize(w_.size() + 3 * size_t(n), 0.0);
    }
    double* const w = w_.data() + at;
    for (int i = 0; i < 3; ++i) {
      for (int c = 0; c < n; ++c) w[i * n + c] += by[a][c] * p[i] + by[a][n + c] * p[3 + i];
    }
  }
}

/// Adds the rows of the observation in the anchoring image.
void WindowProblem::AddAnchor(const AnchorRows& row, Landmark* landmark) {
  landmark->hessian[0] += Squared(row.scale);
  landmark->hessian[3] += Squared(row.scale);
  for (int i = 0; i < 2; ++i) landmark->gradient[i] += row.scale * row.r[i];
}

/// Adds damping to H, then replaces it by L and computes L^-1 g. False if H is not positive
/// definite.
bool WindowProblem::FactorizeLandmark(Landmark* landmark) {
  constexpr int kDiagonal[] = {0, 3, 5};
  constexpr double kNothing = 1e-15;
  double* const h = landmark->hessian;
  for (int i = 0; i < 3; ++i) {
    double& entry = h[kDiagonal[i]];
    if (!is_scaled_) landmark->scale[i] = JacobiScale(entry);
    landmark->d_squared[i] = SquaredDamping(entry, landmark->scale[i]);
    entry += damping_ * landmark->d_squared[i];
  }
  const double yy = h[3], ll = h[5];
  if (!(h[0] > 0)) return false;
  h[0] = std::sqrt(h[0]);
  h[1] /= h[0];
  h[2] /= h[0];
  h[3] -= h[1] * h[1];
  if (!(h[3] > kNothing * yy)) return false;
  h[3] = std::sqrt(h[3]);
  h[4] = (h[4] - h[1] * h[2]) / h[3];
  h[5] -= h[2] * h[2] + h[4] * h[4];
  if (!(h[5] > kNothing * ll)) return false;
  h[5] = std::sqrt(h[5]);
  double* const y = landmark->solved;
  y[0] = landmark->gradient[0] / h[0];
  y[1] = (landmark->gradient[1] - h[1] * y[0]) / h[3];
  y[2] = (landmark->gradient[2] - h[2] * y[0] - h[4] * y[1]) / h[5];
  return true;
}

/// Sorts `touched_` by place.
void WindowProblem::Eliminate(Landmark* landmark) {
  landmark->is_regular = FactorizeLandmark(landmark);
  if (!landmark->is_regular) return;  // no row depends on its depth
  const double* const l = landmark->hessian;
  const double* const solved = landmark->solved;
  for (const int a : touched_) {  // V = W L^-T, coordinate by coordinate
    const int n = view_.BlockSize(a);
    double *const x = w_.data() + touched_at_[a], *const y = x + n, *const z = y + n;
    double* const rhs = system_.rhs.data() + Column(a);
    for (int c = 0; c < n; ++c) {
      x[c] /= l[0];
      y[c] = (y[c] - l[1] * x[c]) / l[3];
      z[c] = (z[c] - l[2] * x[c] - l[4] * y[c]) / l[5];
      rhs[c] += x[c] * solved[0] + y[c] * solved[1] + z[c] * solved[2];
    }
  }
  // Rows are those of the later block: in this order, a column's entries are found one by one.
  std::sort(touched_.begin(), touched_.end(), [&](int a, int b) { return place_[a] < place_[b]; });
  for (size_t k = 0; k < touched_.size(); ++k) {
    const int b = touched_[k], column = place_[b], stride = structure_.panel_stride[column];
    int64_t entry = structure_.column_begin[column];
    for (size_t m = k; m < touched_.size(); ++m) {
      const int a = touched_[m];
      while (structure_.row_block[entry] != place_[a]) ++entry;
      SubtractProduct(w_.data() + touched_at_[a], view_.BlockSize(a), w_.data() + touched_at_[b],
                      view_.BlockSize(b),
                      system_.values.data() + structure_.ValueIndex(column, entry, 0, 0), stride);
    }
  }
}

}  // namespace bundle
