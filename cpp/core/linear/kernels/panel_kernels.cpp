#include "core/linear/kernels/panel_kernels.h"

/// The kernels of panel_kernels.h for one instruction set. This file is compiled once for each of
/// them, with BUNDLE_ISA, the name of the namespace, and BUNDLE_LANES, the doubles of a register.
///
/// Products are computed in tiles (panel_tile.h).
///
/// The factorisation goes through kLanes columns at a time, left-looking. With L the columns before
/// and D the diagonal block, which is one register high,
///
///   D - L_D L_D^T = M M^T,      then for tiles of the rows below    (B - L_B L_D^T) M^-T,
///
/// with the triangular solve in registers. All of it is in columns of lanes. With v_c the column c
/// of D after the earlier columns, a later column k subtracts v_c (v_kc / v_cc), and column c of M
/// is v_c / sqrt(v_cc). So no column waits for a square root.

#include "core/linear/kernels/panel_tile.h"

namespace bundle::BUNDLE_ISA {

// As in parallel/pack.h, no inline function of the standard library is used: two copies of
// one, compiled for different instruction sets, must never share a name.
namespace {

/// Rows of A that stay in the cache while all columns of C take their sums from them.
constexpr int kRowsAtATime = 24 * kLanes;

template <bool kSubtract>
void MultiplyLower(const double* a, int64_t stride, int rows, int columns, int width, double* c,
                   int64_t c_stride) {
  for (int top = 0; top < rows; top += kRowsAtATime) {
    const int end = Least(rows, top + kRowsAtATime);
    for (int column = 0; column < Least(columns, end); column += kLanes) {
      const int first = column > top ? column : top;
      WithColumns(Least(kLanes, columns - column), [&](auto count) {
        ForTiles<count.kCount>(end - first, [&](auto tile, int row) {
          double* const at = c + first + row + column * c_stride;
          if (kSubtract) tile.Read(at, c_stride);
          tile.template Accumulate<kSubtract>(a + first + row, a + column, stride, width);
          tile.Write(at, c_stride);
        });
      });
    }
  }
}

void Scatter(const double* product, int64_t stride, int columns, const RowRange* ranges,
             int num_ranges, double* to, int64_t to_stride) {
  const auto subtract = [](const double* from, int count, double* at) {
    int i = 0;
    for (; i + kLanes <= count; i += kLanes) Store(Load(at + i) - Load(from + i), at + i);
    const int rest = count - i;
    if (rest > 0) StoreFirst(LoadFirst(at + i, rest) - LoadFirst(from + i, rest), rest, at + i);
  };
  for (int own = 0; own < num_ranges && ranges[own].source < columns; ++own) {
    const int count = Least(ranges[own].length, columns - ranges[own].source);
    for (int j = 0; j < count; ++j) {
      const double* const from = product + (ranges[own].source + j) * stride;
      double* const column = to + (ranges[own].target + j) * to_stride;
      subtract(from + ranges[own].source + j, ranges[own].length - j,
               column + ranges[own].target + j);
      for (int r = own + 1; r < num_ranges; ++r) {
        subtract(from + ranges[r].source, ranges[r].length, column + ranges[r].target);
      }
    }
  }
}

/// L of a diagonal block, without its diagonal, and the reciprocals of that.
template <int kColumns>
struct Triangle {
  double factor[kColumns][kColumns];  ///< [c][k]: entry (k, c)
  double reciprocal[kColumns];
};

/// B = (B - A L_D^T) M^-T for columns [first, first + kColumns) of `rows` rows, where A is the
/// columns before and `l` is M.
template <int kColumns>
inline void SolveColumns(const Triangle<kColumns>& l, const double* panel, int64_t stride,
                         int first, double* b, int rows) {
  ForTiles<kColumns>(rows, [&](auto tile, int row) {
    constexpr int kVectors = sizeof tile.v[0] / sizeof(Vector);
    double* const to = b + row + first * stride;
    tile.Read(to, stride);
    tile.template Accumulate<true>(b + row, panel + first, stride, first);
#pragma GCC unroll 8
    for (int c = 0; c < kColumns; ++c) {
#pragma GCC unroll 3
      for (int i = 0; i < kVectors; ++i) tile.v[c][i] *= Broadcast(l.reciprocal[c]);
#pragma GCC unroll 8
      for (int k = c + 1; k < kColumns; ++k) {
        const Vector factor = Broadcast(l.factor[c][k]);
#pragma GCC unroll 3
        for (int i = 0; i < kVectors; ++i) {
          tile.v[k][i] = SubtractProduct(tile.v[k][i], tile.v[c][i], factor);
        }
      }
    }
    tile.Write(to, stride);
  });
}

/// Returns 0, or the number of the first column that fails.
template <int kColumns>
inline int FactorizeColumns(double* panel, int64_t stride, int height, int first) {
  Tile<1, kColumns, kColumns != kLanes> diagonal{};
  diagonal.last = kColumns;
  Triangle<kColumns> l;
  double* const at = panel + first + first * stride;
  diagonal.Read(at, stride);
  diagonal.template Accumulate<true>(panel + first, panel + first, stride, first);
  Vector pivots = diagonal.v[0][0];
#pragma GCC unroll 8
  for (int c = 0; c < kColumns; ++c) {
    const Vector& column = diagonal.v[c][0];
    pivots[c] = column[c];
    if (!(pivots[c] > 0)) return c + 1;
    const Vector multiples = column / Broadcast(column[c]);
#pragma GCC unroll 8
    for (int k = c + 1; k < kColumns; ++k) {
      diagonal.v[k][0] -= column * Broadcast(multiples[k]);
    }
  }
#pragma GCC unroll 8
  for (int c = 0; c < kColumns; ++c) {
    Vector& column = diagonal.v[c][0];
    const double root = __builtin_sqrt(pivots[c]);
    l.reciprocal[c] = 1 / root;
    column *= Broadcast(l.reciprocal[c]);
    column[c] = root;
#pragma GCC unroll 8
    for (int k = c + 1; k < kColumns; ++k) l.factor[c][k] = column[k];
  }
  diagonal.Write(at, stride);
  const int below = first + kColumns;
  SolveColumns(l, panel, stride, first, panel + below, height - below);
  return 0;
}

int Factorize(double* panel, int64_t stride, int height, int width) {
  for (int first = 0; first < width; first += kLanes) {
    int failed = 0;
    WithColumns(Least(kLanes, width - first), [&](auto count) {
      failed = FactorizeColumns<count.kCount>(panel, stride, height, first);
    });
    if (failed != 0) return first + failed;
  }
  return 0;
}

void SolveRows(const double* panel, int64_t stride, int width, double* b, int rows) {
  for (int first = 0; first < width; first += kLanes) {
    WithColumns(Least(kLanes, width - first), [&](auto count) {
      constexpr int kColumns = count.kCount;
      Triangle<kColumns> l;
      const double* column = panel + first + first * stride;
      for (int c = 0; c < kColumns; ++c, column += stride) {
        l.reciprocal[c] = 1 / column[c];
#pragma GCC unroll 8
        for (int k = c + 1; k < kColumns; ++k) l.factor[c][k] = column[k];
      }
      SolveColumns(l, panel, stride, first, b, rows);
    });
  }
}

/// A times y, for `rows` rows.
inline void Multiply(const double* a, int64_t stride, int rows, int width, const double* y,
                     double* product) {
  ForTiles<1>(rows, [&](auto tile, int row) {
    const double* column = a + row;
    constexpr int kVectors = sizeof tile.v[0] / sizeof(Vector);
    for (int j = 0; j < width; ++j, column += stride) {
      const Vector factor = Broadcast(y[j]);
#pragma GCC unroll 3
      for (int i = 0; i < kVectors; ++i) {
        tile.v[0][i] += tile.LoadRows(column, i, tile.last) * factor;
      }
    }
    tile.Write(product + row, 0);
  });
}

/// Subtracts the transpose of `rows` rows, times x, from y.
inline void SubtractTransposed(const double* a, int64_t stride, int rows, int width,
                               const double* x, double* y) {
  constexpr int kAtATime = 4;
  const int whole = rows / kLanes * kLanes, rest = rows - whole;
  for (int first = 0; first < width; first += kAtATime) {
    WithColumns(Least(kAtATime, width - first), [&](auto count) {
      Vector sum[count.kCount] = {};
      const double* const b = a + first * stride;
      for (int i = 0; i < whole; i += kLanes) {
        const Vector factor = Load(x + i);
#pragma GCC unroll 4
        for (int c = 0; c < count.kCount; ++c) sum[c] += Load(b + c * stride + i) * factor;
      }
      if (rest > 0) {
        const Vector factor = LoadFirst(x + whole, rest);
#pragma GCC unroll 4
        for (int c = 0; c < count.kCount; ++c) {
          sum[c] += LoadFirst(b + c * stride + whole, rest) * factor;
        }
      }
#pragma GCC unroll 4
      for (int c = 0; c < count.kCount; ++c) y[first + c] -= SumOfLanes(sum[c]);
    });
  }
}

/// Solves with a triangle in registers, or with its transpose. The quotients do not wait for y.
template <int kColumns, bool kTransposed>
inline void SolveTriangle(const double* l, int64_t stride, double* y) {
  double x[kColumns];
#pragma GCC unroll 8
  for (int i = 0; i < kColumns; ++i) x[i] = y[i];
#pragma GCC unroll 8
  for (int k = 0; k < kColumns; ++k) {
    const int j = kTransposed ? kColumns - 1 - k : k;
    x[j] *= 1 / l[j + j * stride];
#pragma GCC unroll 8
    for (int i = kTransposed ? 0 : j + 1; i < (kTransposed ? j : kColumns); ++i) {
      x[i] -= (kTransposed ? l[j + i * stride] : l[i + j * stride]) * x[j];
    }
  }
#pragma GCC unroll 8
  for (int i = 0; i < kColumns; ++i) y[i] = x[i];
}

void Forward(const double* panel, int64_t stride, int height, int width, double* y, double* below) {
  for (int first = 0; first < width; first += kLanes) {
    WithColumns(Least(kLanes, width - first), [&](auto count) {
      if (first > 0) {
        double before[count.kCount];
        Multiply(panel + first, stride, count.kCount, first, y, before);
#pragma GCC unroll 8
        for (int i = 0; i < count.kCount; ++i) y[first + i] -= before[i];
      }
      SolveTriangle<count.kCount, false>(panel + first + first * stride, stride, y + first);
    });
  }
  Multiply(panel + width, stride, height - width, width, y, below);
}

void Backward(const double* panel, int64_t stride, int height, int width, double* y,
              const double* below) {
  SubtractTransposed(panel + width, stride, height - width, width, below, y);
  for (int next = width; next > 0; next = (next - 1) / kLanes * kLanes) {
    const int first = (next - 1) / kLanes * kLanes;
    WithColumns(next - first, [&](auto count) {
      SubtractTransposed(panel + next + first * stride, stride, width - next, count.kCount,
                         y + next, y + first);
      SolveTriangle<count.kCount, true>(panel + first + first * stride, stride, y + first);
    });
  }
}

}  // namespace

extern constexpr PanelKernels kPanelKernels = {&MultiplyLower<true>,
                                               &MultiplyLower<false>,
                                               &Scatter,
                                               &Factorize,
                                               &SolveRows,
                                               &Forward,
                                               &Backward};

}  // namespace bundle::BUNDLE_ISA
