/// Part of SupernodalCholesky (supernodal_cholesky.h): entries of S^-1 in the pattern of its
/// Cholesky factor, by Takahashi's recursion (K. Takahashi, J. Fagan, M.-S. Chin: Formation of a
/// sparse bus impedance matrix and its application to short circuit study, 1973; A. M. Erisman, W.
/// F. Tinney: On computing certain elements of the inverse of a sparse matrix, 1975), panel by
/// panel.
///
/// Let Z = S^-1 = L^-T L^-1, hence Z L = L^-T, which is upper triangular. For a panel with its own
/// columns J and the rows R below them,
///
///   G = L_RJ L_JJ^-1,     Z_RJ = -Z_RR G,     Z_JJ = (L_JJ L_JJ^T)^-1 + G^T Z_RR G.
///
/// The rows R of a panel are a clique of the filled graph. So Z_RR is within the pattern of L, in
/// later panels. These are complete, because panels are processed from the last to the first. Z_RR
/// is never gathered as one matrix, but panel by panel: with K the rows of R that are columns of
/// one later panel, and M the rows below K,
///
///   (Z_RR G)_K += Z_KK G_K + Z_MK^T G_M,       (Z_RR G)_M += Z_MK G_K.
///
/// It works in place, at three times the flops of the factorisation (J. N. Rust, E. Ng, and others
/// measure the same). Additional memory: G and its product for one panel, and one strip of Z_RR.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/linear/supernodal_cholesky.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

void SupernodalCholesky::Invert(double* values) {
  for (int s = supernodes_.num_panels() - 1; s >= 0; --s) {
    ThrowIfInterrupted();
    InvertPanel(s, values);
  }
}

void SupernodalCholesky::InvertPanel(int panel, double* values) {
  constexpr char kRight = 'R', kLower = 'L', kPlain = 'N', kTransposed = 'T', kNonUnit = 'N';
  constexpr double kMinusOne = -1, kOne = 1;
  const int width = Width(panel), height = supernodes_.height[panel], below = height - width;
  double* const own = values + supernodes_.values_begin[panel];
  std::vector<double> g, product, strip;
  if (below > 0) {
    g.resize(static_cast<size_t>(below) * width);
    for (int c = 0; c < width; ++c) {
      std::copy_n(own + static_cast<int64_t>(c) * height + width, below, &g[size_t(c) * below]);
    }
    dtrsm_(&kRight, &kLower, &kPlain, &kNonUnit, &below, &width, &kOne, own, &height, g.data(),
           &below);
    product.assign(g.size(), 0.0);
  }
  const int64_t end = supernodes_.rows_begin[panel + 1];
  for (int64_t first = supernodes_.rows_begin[panel]; first < end;) {
    const int by = panel_of_[supernodes_.row_block[first]];
    int64_t last = first;
    while (last < end && panel_of_[supernodes_.row_block[last]] == by) ++last;
    const int top = supernodes_.row_in_panel[first] - width;
    const int columns = supernodes_.row_in_panel[last - 1] + BlockSize(last - 1) - width - top;
    const int rows = below - top;
    CopyStrip(values, by, first, last, end, rows, &strip);
    const double* const gk = &g[top];
    double* const to = &product[top];
    // All rows of the strip by the columns K; rows below K by their transposes.
    dgemm_(&kPlain, &kPlain, &rows, &width, &columns, &kOne, strip.data(), &rows, gk, &below, &kOne,
           to, &below);
    const int rest = rows - columns;
    if (rest > 0) {
      dgemm_(&kTransposed, &kPlain, &columns, &width, &rest, &kOne, strip.data() + columns, &rows,
             gk + columns, &below, &kOne, to, &below);
    }
    first = last;
  }
  int info = 0;
  dpotri_(&kLower, &width, own, &height, &info);
  for (int c = 0; c < width; ++c) {
    for (int r = 0; r < c; ++r) {
      own[static_cast<int64_t>(c) * height + r] = own[static_cast<int64_t>(r) * height + c];
    }
  }
  if (below == 0) return;
  dgemm_(&kTransposed, &kPlain, &width, &width, &below, &kOne, g.data(), &below, product.data(),
         &below, &kOne, own, &height);
  for (int c = 0; c < width; ++c) {
    const double* const from = &product[size_t(c) * below];
    double* const to = own + static_cast<int64_t>(c) * height + width;
    for (int r = 0; r < below; ++r) to[r] = kMinusOne * from[r];
  }
}

/// Block rows [first, end) of a panel of Z by its block rows [first, last), which are columns of
/// panel `by`: rows x columns, column-major.
void SupernodalCholesky::CopyStrip(const double* values, int by, int64_t first, int64_t last,
                                   int64_t end, int rows, std::vector<double>* strip) {
  std::vector<int>& position = scratch_.front().position;
  LocateRows(by, &position);
  const int height = supernodes_.height[by];
  const double* const from = values + supernodes_.values_begin[by];
  int columns = 0;
  for (int64_t e = first; e < last; ++e) columns += BlockSize(e);
  strip->resize(static_cast<size_t>(rows) * columns);
  double* to = strip->data();
  for (int64_t e = first; e < last; ++e) {
    const double* column = from + static_cast<int64_t>(position[supernodes_.row_block[e]]) * height;
    for (int c = 0; c < BlockSize(e); ++c, column += height) {
      for (int64_t f = first; f < end; ++f) {
        to = std::copy_n(column + position[supernodes_.row_block[f]], BlockSize(f), to);
      }
    }
  }
}

}  // namespace bundle
