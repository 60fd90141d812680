#pragma once

/// Tiles of the panel kernels. Included by panel_kernels.cpp only, once for each instruction set.
///
/// A tile of C has some registers of rows times kLanes columns. It stays in registers while the sum
/// over the columns of A runs. Each step loads a column of the tile's rows, and multiplies it by
/// one number per column of the tile:
///
///   C_ij = sum_k A_ik A_jk,     i: lanes and registers,   j: registers,   k: loop.
///
/// With 24 accumulators of 8 doubles, 3 loads and 8 broadcasts feed 24 fused multiply-adds.
/// Operands are read where they are: no row is copied. Rows that do not fill a register are read
/// and written under a mask.
///
/// Loops over the registers of a tile are unrolled: GCC would otherwise keep a tile in memory.

#include "core/linear/kernels/panel_vectors.h"

namespace bundle::BUNDLE_ISA {
namespace {

/// Registers of rows in a tile. The accumulators and a column of rows fit into the registers.
#if defined(__AVX2__)
constexpr int kTileVectors = 3;
#else
constexpr int kTileVectors = 1;
#endif

/// kVectors registers of rows times kColumns columns. The last register has `last` rows if
/// kPartial.
template <int kVectors, int kColumns, bool kPartial>
struct Tile {
  Vector v[kColumns][kVectors];
  int last;

  static Vector LoadRows(const double* from, int i, int last) {
    return kPartial && i == kVectors - 1 ? LoadFirst(from + i * kLanes, last)
                                         : Load(from + i * kLanes);
  }
  void Read(const double* from, int64_t stride) {
#pragma GCC unroll 8
    for (int c = 0; c < kColumns; ++c) {
#pragma GCC unroll 3
      for (int i = 0; i < kVectors; ++i) v[c][i] = LoadRows(from + c * stride, i, last);
    }
  }
  void Write(double* to, int64_t stride) const {
#pragma GCC unroll 8
    for (int c = 0; c < kColumns; ++c) {
#pragma GCC unroll 3
      for (int i = 0; i < kVectors; ++i) {
        double* const at = to + c * stride + i * kLanes;
        if (kPartial && i == kVectors - 1) {
          StoreFirst(v[c][i], last, at);
        } else {
          Store(v[c][i], at);
        }
      }
    }
  }
  /// Adds or subtracts a times the transpose of b, `width` columns each.
  template <bool kSubtract>
  void Accumulate(const double* a, const double* b, int64_t stride, int width) {
    for (int k = 0; k < width; ++k, a += stride, b += stride) {
      Vector rows[kVectors];
#pragma GCC unroll 3
      for (int i = 0; i < kVectors; ++i) rows[i] = LoadRows(a, i, last);
#pragma GCC unroll 8
      for (int c = 0; c < kColumns; ++c) {
        const Vector factor = Broadcast(b[c]);
#pragma GCC unroll 3
        for (int i = 0; i < kVectors; ++i) {
          if (kSubtract) {
            v[c][i] = SubtractProduct(v[c][i], rows[i], factor);
          } else {
            v[c][i] += rows[i] * factor;
          }
        }
      }
    }
  }
};

/// Calls visit(tile, first row) for tiles that cover `rows` rows.
template <int kColumns, typename Visit>
inline void ForTiles(int rows, const Visit& visit) {
  constexpr int kTall = kTileVectors * kLanes;
  int row = 0;
  for (; row + kTall <= rows; row += kTall) visit(Tile<kTileVectors, kColumns, false>{}, row);
  const int rest = rows - row;
  if (rest == 0) return;
  const int last = rest % kLanes;
  const auto run = [&](auto tile) {
    tile.last = last;
    visit(tile, row);
  };
  if constexpr (kTileVectors == 3) {
    if (rest > 2 * kLanes) return run(Tile<3, kColumns, true>{});
    if (rest == 2 * kLanes) return run(Tile<2, kColumns, false>{});
    if (rest > kLanes) return run(Tile<2, kColumns, true>{});
  }
  if (rest == kLanes) return run(Tile<1, kColumns, false>{});
  run(Tile<1, kColumns, true>{});
}

/// Calls visit(integral constant) with the number of columns.
template <int kColumns>
struct Columns {
  static constexpr int kCount = kColumns;
};

template <typename Visit>
inline void WithColumns(int columns, const Visit& visit) {
  if constexpr (kLanes == 8) {
    switch (columns) {
      case 8:
        return visit(Columns<8>{});
      case 7:
        return visit(Columns<7>{});
      case 6:
        return visit(Columns<6>{});
      case 5:
        return visit(Columns<5>{});
    }
  }
  switch (columns) {
    case 4:
      return visit(Columns<4>{});
    case 3:
      return visit(Columns<3>{});
    case 2:
      return visit(Columns<2>{});
    default:
      return visit(Columns<1>{});
  }
}

}  // namespace
}  // namespace bundle::BUNDLE_ISA
