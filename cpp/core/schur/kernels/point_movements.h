#pragma once

/// Movements of points with the camera parameters. Included by kernels.cpp only.
///
/// Steps X of the camera parameters, by columns, move a point by -Y^T X with Y = W V^-1. With the
/// factors Z of its entries and V = L L^T, Y = Z L^-1 (point_covariances.h), so that
///
///   Y^T X = L^-T sum_a Z_a^T X_a.

#include "core/schur/kernels/point_leverages.h"

namespace bundle::BUNDLE_ISA {

inline void PointMovements(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                           const double* steps, int num_quads, double* memory, double* found) {
  if (chunk.last_row > 0) return;
  constexpr double kIdentity[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  const ScatterMemory tile_memory(plan, memory + TileDoubles(input));
  const int64_t entry_stride = int64_t{3} * input.part_columns, width = 4 * int64_t{num_quads};
  TileCursor at = {chunk};
  for (const Tile* tile = chunk.tiles.data(); at.first_point < chunk.last_point; ++tile) {
    const int first_point = at.first_point;
    const int last_point =
        tile->last_point < plan.num_free_points ? tile->last_point : plan.num_free_points;
    if (first_point >= last_point) break;
    const TileRecords records(input, memory, first_point);
    FormTile(input, x, chunk, first_point, last_point, records, memory, tile_memory,
             [&](int p, const PointBlock& block) {
               double* const to = found + (9 + 3 * width) * (p - chunk.first_point);
               double* const rows = to + 9;
               Unwhiten(block, kIdentity, to);
               for (int64_t k = 0; k < 3 * width; ++k) rows[k] = 0;
               ForEntries(input, chunk, begin[p], CountRefined(input, begin[p], begin[p + 1]),
                          [&](uint16_t number, uint16_t slot, bool) {
                            const EntryPair pair = {number, 0};
                            const int part = chunk.parts.data()[slot];
                            kAddTimes[num_quads - 1](
                                memory, 4 * input.part_quads[part], entry_stride, &pair, 1, false,
                                input.part_rows[part], steps + width * input.part_columns * part,
                                rows);
                          });
               for (int a = 0; a < 3; ++a) {  // rows below are not yet transformed
                 double* const row = rows + width * a;
                 for (int64_t k = 0; k < width; ++k) row[k] *= block.column[a][a];
                 for (int r = a + 1; r < 3; ++r) {
                   const double factor = block.column[a][r];
                   const double* const below = rows + width * r;
                   for (int64_t k = 0; k < width; ++k) row[k] += factor * below[k];
                 }
               }
             });
    at.Pass(*tile);
  }
}

}  // namespace bundle::BUNDLE_ISA
