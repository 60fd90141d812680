#pragma once

/// Covariances of points, given those of the camera parameters. Included by kernels.cpp only.
///
/// With V = L L^T, rows A_i and B_i of the point's observations, Y_i = B_i L^-T (eliminate_point.h)
/// and Z_i = A_i^T Y_i (d x 3), W_i V^-1 = Z_i L^-1, and
///
///   V^-1 + V^-1 (sum_ij W_i^T C_ij W_j) V^-1 = L^-T (I + sum_ij Z_i^T C_ij Z_j) L^-1.
///
/// C_ij are the blocks of image pairs that the elimination sums up for the chunk, with the same
/// block numbers. For each j, the rows Z_i^T C_ij are summed over i <= j, with half of the diagonal
/// block, and multiplied by Z_j. This sum plus its transpose is the sum over all ij.

#include <type_traits>

#include "core/schur/kernels/eliminate_chunk.h"
#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"
#include "core/schur/kernels/survey_points.h"

namespace bundle::BUNDLE_ISA {

/// Widest vector type that divides a row of kQuads quads.
template <int kQuads>
struct WideRow {
  static constexpr bool kIsWide = kLanes == 8 && kQuads % 2 == 0;
  using Oct = double __attribute__((vector_size(64)));
  using Type = std::conditional_t<kIsWide, Oct, Quad>;
  static constexpr int kDoubles = kIsWide ? 8 : 4;
  static constexpr int kCount = 4 * kQuads / kDoubles;

  static Type Load(const double* from) {
    Type value;
    __builtin_memcpy(&value, from, sizeof value);
    return value;
  }
};

/// Z^T C for some rows of C: three rows of camera parameters' columns.
template <int kQuads>
struct ThreeRows {
  using Wide = WideRow<kQuads>;
  typename Wide::Type row[3][Wide::kCount];

  /// += Z^T C: `z` has three rows of `stride` doubles, C `num_rows` rows.
  void AddProduct(const double* z, int stride, int num_rows, const double* c) {
    for (int r = 0; r < num_rows; ++r, c += 4 * kQuads) {
#pragma GCC unroll 8
      for (int q = 0; q < Wide::kCount; ++q) {
        const auto at = Wide::Load(c + Wide::kDoubles * q);
        for (int k = 0; k < 3; ++k) row[k][q] += z[k * stride + r] * at;
      }
    }
  }

  void Halve() {
    for (auto& of_row : row) {
      for (int q = 0; q < Wide::kCount; ++q) of_row[q] *= 0.5;
    }
  }

  /// sum[k][m] += row k times row m of z, in four parts.
  void AddTo(const double* z, int stride, Quad (*sum)[3]) const {
    for (int m = 0; m < 3; ++m) {
      typename Wide::Type product[3] = {};
#pragma GCC unroll 8
      for (int q = 0; q < Wide::kCount; ++q) {
        const auto at = Wide::Load(z + m * stride + Wide::kDoubles * q);
        for (int k = 0; k < 3; ++k) product[k] += row[k][q] * at;
      }
      for (int k = 0; k < 3; ++k) {
        Quad parts[2];
        __builtin_memcpy(parts, &product[k], sizeof product[k]);
        sum[k][m] += Wide::kIsWide ? parts[0] + parts[1] : parts[0];
      }
    }
  }
};

/// Data of one point: its refined observations, their Z^T and the blocks of C.
struct PointPairs {
  const EliminationInput& input;
  const double* blocks;        ///< blocks of the chunk, as in Kernels::point_covariances
  const int64_t* block_begin;  ///< used with mixed widths
  const int32_t* image;
  const uint16_t* image_in_chunk;
  const uint16_t* pair_block;  ///< block of the point's first pair
  int refined;
  const double* z;  ///< three rows per observation, each of input.num_columns doubles

  const double* Block(int64_t b) const {
    return blocks + (input.mixed ? block_begin[b]
                                 : b * input.num_rows * static_cast<int64_t>(input.num_columns));
  }
  int NumRows(int i) const { return input.mixed ? input.image_columns[image[i]] : input.num_rows; }
  const double* Z(int i) const { return z + 3 * static_cast<int64_t>(i) * input.num_columns; }

  /// Adds sum_i<=j Z_i^T C_ij Z_j, with half of the term i = j.
  template <int kQuads>
  void AddColumn(int j, Quad (*sum)[3]) const {
    const int stride = input.num_columns;
    ThreeRows<kQuads> total = {};
    total.AddProduct(Z(j), stride, NumRows(j), Block(image_in_chunk[j]));
    total.Halve();
    // Pair (i, j) has the number i (2 refined - i - 1) / 2 + j - i - 1.
    const uint16_t* pair = pair_block + j - 1;
    for (int i = 0; i < j; ++i) {
      total.AddProduct(Z(i), stride, NumRows(i), Block(*pair));
      pair += refined - i - 2;
    }
    total.AddTo(Z(j), stride, sum);
  }
};

using AddColumnOfPairs = void (PointPairs::*)(int, Quad (*)[3]) const;
inline constexpr AddColumnOfPairs kAddColumn[] = {
    &PointPairs::AddColumn<1>, &PointPairs::AddColumn<2>, &PointPairs::AddColumn<3>,
    &PointPairs::AddColumn<4>, &PointPairs::AddColumn<5>, &PointPairs::AddColumn<6>};

/// Z^T of a white record, three rows of `stride` doubles.
inline void FormZ(const double* head, const double* rows, int width, int stride, double* z) {
  for (int k = 0; k < 3; ++k) {
    for (int c = 0; c < width; c += 4) {
      StoreQuad(head[k] * LoadQuad(rows + c) + head[4 + k] * LoadQuad(rows + width + c),
                z + k * stride + c);
    }
  }
}

/// L^-T X L^-1, of a symmetric X; row-major.
inline void Unwhiten(const PointBlock& block, const double (*x)[3], double* out) {
  for (int a = 0; a < 3; ++a) {
    double by_row[3] = {};  // row a of L^-T X
    for (int s = 0; s < 3; ++s) {
      for (int r = a; r < 3; ++r) by_row[s] += block.column[a][r] * x[r][s];
    }
    for (int b = a; b < 3; ++b) {
      double sum = 0;
      for (int s = b; s < 3; ++s) sum += by_row[s] * block.column[b][s];
      out[3 * a + b] = out[3 * b + a] = sum;
    }
  }
}

/// Subtracts N_p N_p^T V^-1 and its transpose (covariance/free_gauge.h).
inline void TakeMovesOut(const WorldMoves& moves, const double* point, const double* inverse,
                         double* covariance) {
  MoveRow n[3], free[3];
  MovesOfPoint(moves, point, n);
  for (int i = 0; i < 3; ++i) {
    free[i] = {};
    for (int m = 0; m < 7; ++m) {
      free[i] = free[i] + n[i].half[m / 4][m % 4] * MoveRow::Load(moves.combinations + kMoves * m);
    }
  }
  double squares[3][3], back[3][3];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const Quad dot = free[i].half[0] * free[j].half[0] + free[i].half[1] * free[j].half[1];
      squares[i][j] = (dot[0] + dot[1]) + (dot[2] + dot[3]);
    }
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) back[i][j] = Dot3(squares[i], inverse + 3 * j);
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) covariance[3 * i + j] -= back[i][j] + back[j][i];
  }
}

inline void PointCovariances(const EliminationInput& input, const StateRecords& x,
                             const Chunk& chunk, const WorldMoves& moves, const double* blocks,
                             const int64_t* block_begin, double* memory, double* covariances) {
  const StripRecords records(input, memory);
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  const int num_free = plan.num_free_points, stride = input.num_columns;
  const int last_point = chunk.last_point < num_free ? chunk.last_point : num_free;
  if (chunk.last_row > 0) return;
  double* const z = memory + (kMixedStripObservations + input.longest_track) * records.stride();
  const uint16_t* pair_block = plan.pair_block.data() + chunk.first_pair;
  PointBlock point_blocks[kStripPoints];
  for (int first = chunk.first_point; first < last_point;) {
    const Strip strip(input, first, last_point);
    VisitLanes(input, strip,
               [&](const Lanes& lanes) { LinearizeLanes(input, x, strip, lanes, records); });
    FormPointBlocks(input, strip, records.Of(0), records.stride(), 0, true, nullptr, point_blocks);
    for (int p = strip.first; p < strip.last; ++p) {
      const PointBlock& block = point_blocks[p - strip.first];
      const int64_t slot = begin[p] - strip.begin;
      const int refined = CountRefined(input, begin[p], begin[p + 1]);
      const int32_t* const image = plan.image.data() + begin[p];
      WhitenRows(records, slot, refined, &block);
      const PointPairs pairs = {
          input,   blocks, block_begin, image, plan.image_in_chunk.data() + begin[p], pair_block,
          refined, z};
      Quad sum[3][3] = {};
      for (int j = 0; j < refined; ++j) {
        const int quads = input.mixed ? input.image_quads[image[j]] : stride / 4;
        FormZ(records.Of(slot + j), records.Rows(slot + j), 4 * quads, stride,
              z + 3 * static_cast<int64_t>(j) * stride);
        (pairs.*kAddColumn[quads - 1])(j, sum);
      }
      pair_block += static_cast<int64_t>(refined) * (refined - 1) / 2;
      constexpr double kIdentity[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
      double whole[3][3];
      for (int k = 0; k < 3; ++k) {
        for (int m = 0; m < 3; ++m) {
          const Quad both = sum[k][m] + sum[m][k];
          whole[k][m] = kIdentity[k][m] + (both[0] + both[1]) + (both[2] + both[3]);
        }
      }
      double* const out = covariances + 9 * static_cast<int64_t>(p - chunk.first_point);
      Unwhiten(block, whole, out);
      if (moves.combinations == nullptr) continue;
      double inverse[9];
      Unwhiten(block, kIdentity, inverse);
      TakeMovesOut(moves, x.points + 3 * int64_t{p}, inverse, out);
    }
    first = strip.last;
  }
}

}  // namespace bundle::BUNDLE_ISA
