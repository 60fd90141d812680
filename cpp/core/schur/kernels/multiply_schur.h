#pragma once

/// The product of S with a step d of the camera parameters, without S. Included by kernels.cpp
/// only.
///
/// With the notation of eliminate_point.h and u_i = A_i d, the Schur complement of a point gives
///
///   S d = sum A_i^T (u_i - Y_i h),    h = L^-1 sum B_i^T u_i,
///
/// the reduced right-hand side with u in place of the residuals r (without factors of points). So
/// the pass is an elimination without pairs: it costs a linearisation and two products with A_i per
/// observation. Storing A_i and Y_i instead would take 200 bytes per observation, and reading them
/// nearly as long.

#include "core/schur/kernels/eliminate_chunk.h"

namespace bundle::BUNDLE_ISA {

/// vector += sum of A^T (u - Y h) over observations with finished records.
template <int kQuads>
void AddReduced(const ImageRecords& records, int first, double* vector) {
  using Row = WideRow<kQuads>;
  Row sum = Row::Load(vector);
  for (int i = 0; i < records.count; ++i) {
    const double* const record = records.first + records.stride * records.observations[i];
    sum.Add(record[2], Row::Load(record + first));
    sum.Add(record[3], Row::Load(record + first + records.row_stride));
  }
  sum.Store(vector);
}

inline constexpr decltype(&AddReduced<1>) kAddReduced[] = {
    &AddReduced<1>, &AddReduced<2>, &AddReduced<3>, &AddReduced<4>,
    &AddReduced<5>, &AddReduced<6>, &AddReduced<7>};

inline void MultiplySchur(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                          double damping, const double* squared_scale, const StepRecords& step,
                          double* memory, double* vectors) {
  const int64_t* const begin = input.plan->first.data();
  double ignored = 0;
  TileCursor at = {chunk};
  for (const Tile* tile = chunk.tiles.data(); at.first_point < chunk.last_point; ++tile) {
    const TileRecords records(input, memory, at.first_point);
    VisitPoints<true>(
        input, x, at.first_point, tile->last_point, damping, false, squared_scale, records,
        &ignored,
        [&](int p, const PointBlock& block) {
          const int num_refined = CountRefined(input, begin[p], begin[p + 1]);
          if (p >= input.plan->num_free_points) {
            FinishConstantHeads(records, begin[p], num_refined);
            return;
          }
          VisitHeads<true>(input, records, begin[p], num_refined, input.plan->num_kinds, block,
                           [](int64_t, const double*, const uint16_t*) {});
        },
        &step);
    ForImages(input, at.image, at.EndOfImages(*tile), at.observations, begin[at.first_point],
              records, /*last_bit=*/0,
              [&](const ModelGroup& group, const Tile::Image& image, const ImageRecords& of) {
                for (int kind = 0; kind < input.plan->num_kinds; ++kind) {
                  const uint16_t part = chunk.images.data()[image.image].part[kind];
                  if (part == Chunk::Image::kNone) continue;
                  const ModelGroup::Part& columns = group.parts[kind];
                  kAddReduced[columns.num_quads - 1](of, kRecordHead + 4 * columns.first_quad,
                                                     vectors + int64_t{input.part_columns} * part);
                }
              });
    at.Pass(*tile);
  }
}

}  // namespace bundle::BUNDLE_ISA
