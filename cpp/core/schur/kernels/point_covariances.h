#pragma once

/// Covariances of points, given those of the camera parameters. Included by kernels.cpp only.
///
/// With V = L L^T, rows A_i and B_i of the point's observations, Y_i = B_i L^-T (eliminate_point.h)
/// and Z_i = A_i^T Y_i (d x 3), W_i V^-1 = Z_i L^-1, and
///
///   V^-1 + V^-1 (sum_ij W_i^T C_ij W_j) V^-1 = L^-T (I + sum_ij Z_i^T C_ij Z_j) L^-1.
///
/// The kernel sums over pairs of the point's entries a (eliminate_point.h) instead of observations:
/// W V^-1 = Z L^-1 holds for their factors Z_a, too. The pairs of a tile are visited block by
/// block of C, in the order of the elimination. The sum over ab is the sum over a <= b, with half
/// of the squares, plus its transpose.

#include "core/schur/kernels/eliminate_chunk.h"
#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"
#include "core/schur/kernels/survey_points.h"

namespace bundle::BUNDLE_ISA {

/// Adds Z_a^T C_ab Z_b to the sums of the points of some pairs. C_ab has `num_rows` rows of kQuads
/// quads, and entries have `stride` doubles, `width` in a row of Z_a. `sums`: 3 x 3 quads per point
/// of the tile, each in four parts.
template <int kQuads>
void AddScatter(const double* z, int width, int64_t stride, const EntryPair* pairs, int count,
                int num_rows, const double* c, const uint16_t* point_of_entry, Quad* sums) {
  using Row = WideRow<kQuads>;
  for (const EntryPair* pair = pairs; pair < pairs + count; ++pair) {
    const double* const a = z + stride * pair->first;
    const double* const b = z + stride * pair->second;
    const bool is_square = pair->first == pair->second;
    Quad* const sum = sums + 9 * point_of_entry[pair->first];
    for (int k = 0; k < 3; ++k) {
      Row row = {};
      for (int r = 0; r < num_rows; ++r) {
        const double factor = is_square ? -0.5 * a[width * k + r] : -a[width * k + r];
        row.Subtract(factor, Row::Load(c + 4 * kQuads * r));
      }
      for (int m = 0; m < 3; ++m) {
        sum[3 * k + m] += row.Times(Row::Load(b + 4 * kQuads * m));
      }
    }
  }
}

inline constexpr decltype(&AddScatter<1>) kAddScatter[] = {
    &AddScatter<1>, &AddScatter<2>, &AddScatter<3>, &AddScatter<4>,
    &AddScatter<5>, &AddScatter<6>, &AddScatter<7>};

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

/// Memory of a tile's factors and records.
inline int64_t TileDoubles(const EliminationInput& input) {
  return TileRecords::FactorDoubles(input) +
         int64_t{TileRecords::StrideOf(input)} * input.plan->largest_tile_observations;
}

/// Further memory of a tile: the sums and the columns of L^-1 of its points, and the point of each
/// entry.
struct ScatterMemory {
  Quad* sums;
  Quad* columns;
  uint16_t* point_of_entry;

  static int64_t NumDoubles(const EliminationInput& input) {
    const EliminationPlan& plan = *input.plan;
    return int64_t{4} * (9 + 3) * plan.largest_tile_points + plan.largest_tile_entries / 4 + 8;
  }
  ScatterMemory(const EliminationPlan& plan, double* memory)
      : sums(reinterpret_cast<Quad*>(memory)),
        columns(sums + int64_t{9} * plan.largest_tile_points),
        point_of_entry(
            reinterpret_cast<uint16_t*>(columns + int64_t{3} * plan.largest_tile_points)) {}
};

/// The product of an own part that occurs once in its point is not among the pairs of a tile.
inline void AddSingleSquares(const EliminationInput& input, const Chunk& chunk, int64_t begin,
                             int num_refined, const double* z, const double* blocks,
                             const int64_t* block_begin, const uint16_t* point_of_entry,
                             Quad* sums) {
  const int num_kinds = input.plan->num_kinds;
  const uint16_t* entry = input.plan->entry.data() + begin * num_kinds;
  const uint16_t* const image = input.plan->image_in_chunk.data() + begin;
  for (int i = 0; i < num_refined; ++i, entry += num_kinds) {
    const uint16_t slot = chunk.images.data()[image[i]].part[kOwnPart];
    if (slot == Chunk::Image::kNone || !IsSingle(entry, num_kinds, i + 1 == num_refined)) continue;
    const int part = chunk.parts.data()[slot], quads = input.part_quads[part];
    const uint16_t number = EntryNumber(entry[0]);
    const EntryPair pair = {number, number};
    kAddScatter[quads - 1](z, 4 * quads, int64_t{3} * input.part_columns, &pair, 1,
                           input.part_rows[part], blocks + block_begin[slot], point_of_entry, sums);
  }
}

/// Writes the covariance of a point from its sums and the columns of its L^-1.
inline void WriteCovariance(const WorldMoves& moves, const double* point, const Quad* sum,
                            const PointBlock& block, double* out) {
  constexpr double kIdentity[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  double whole[3][3];
  for (int k = 0; k < 3; ++k) {
    for (int m = 0; m < 3; ++m) {
      const Quad both = sum[3 * k + m] + sum[3 * m + k];
      whole[k][m] = kIdentity[k][m] + (both[0] + both[1]) + (both[2] + both[3]);
    }
  }
  Unwhiten(block, whole, out);
  if (moves.combinations == nullptr) return;
  double inverse[9];
  Unwhiten(block, kIdentity, inverse);
  TakeMovesOut(moves, point, inverse, out);
}

/// Linearises a tile's free points and computes the factors of their entries in `z`. Calls
/// visit(p, block of the point) for each point.
template <typename Visit>
inline void FormTile(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                     int first_point, int last_point, const TileRecords& records, double* z,
                     const ScatterMemory& tile_memory, const Visit& visit) {
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  double ignored = 0;
  VisitPoints(input, x, first_point, last_point, 0, true, nullptr, records, &ignored,
              [&](int p, const PointBlock& block) {
                const int refined = CountRefined(input, begin[p], begin[p + 1]);
                FormFactors<0, 0, false>(input, chunk, records, begin[p], refined, block, z);
                const int number = p - first_point;
                const uint16_t* const entry = plan.entry.data() + begin[p] * plan.num_kinds;
                const uint16_t* const image = plan.image_in_chunk.data() + begin[p];
                for (int i = 0; i < refined; ++i) {
                  for (int kind = 0; kind < plan.num_kinds; ++kind) {
                    if (chunk.images.data()[image[i]].part[kind] == Chunk::Image::kNone) continue;
                    tile_memory.point_of_entry[EntryNumber(entry[i * plan.num_kinds + kind])] =
                        static_cast<uint16_t>(number);
                  }
                }
                visit(p, block);
              });
}

inline void PointCovariances(const EliminationInput& input, const StateRecords& x,
                             const Chunk& chunk, const WorldMoves& moves, const double* blocks,
                             const int64_t* block_begin, double* memory, double* covariances) {
  if (chunk.last_row > 0) return;
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  const ScatterMemory tile_memory(plan, memory + TileDoubles(input));
  const int64_t stride = int64_t{3} * input.part_columns;
  TileCursor at = {chunk};
  for (const Tile* tile = chunk.tiles.data(); at.first_point < chunk.last_point; ++tile) {
    const int first_point = at.first_point;
    const int last_point =
        tile->last_point < plan.num_free_points ? tile->last_point : plan.num_free_points;
    const TileRecords records(input, memory, first_point);
    if (first_point < last_point) {
      FormTile(input, x, chunk, first_point, last_point, records, memory, tile_memory,
               [&](int p, const PointBlock& block) {
                 const int number = p - first_point;
                 for (int k = 0; k < 9; ++k) tile_memory.sums[9 * number + k] = Quad{};
                 for (int k = 0; k < 3; ++k) {
                   tile_memory.columns[3 * number + k] = block.column[k];
                 }
               });
    }
    const EntryPair* pairs = at.pairs;
    for (const Tile::Block* of = at.block; of < at.EndOfBlocks(*tile); ++of) {
      const Chunk::Pair pair = PartsOfBlock(chunk, of->block);
      const int first = chunk.parts.data()[pair.first], second = chunk.parts.data()[pair.second];
      kAddScatter[input.part_quads[second] - 1](
          memory, 4 * input.part_quads[first], stride, pairs, of->num_pairs, input.part_rows[first],
          blocks + block_begin[of->block], tile_memory.point_of_entry, tile_memory.sums);
      pairs += of->num_pairs;
    }
    for (int p = first_point; p < last_point; ++p) {
      AddSingleSquares(input, chunk, begin[p], CountRefined(input, begin[p], begin[p + 1]), memory,
                       blocks, block_begin, tile_memory.point_of_entry, tile_memory.sums);
      PointBlock block;
      for (int k = 0; k < 3; ++k) block.column[k] = tile_memory.columns[3 * (p - first_point) + k];
      WriteCovariance(moves, x.points + 3 * int64_t{p}, tile_memory.sums + 9 * (p - first_point),
                      block, covariances + 9 * int64_t{p - chunk.first_point});
    }
    at.Pass(*tile);
  }
}

}  // namespace bundle::BUNDLE_ISA
