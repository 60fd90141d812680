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
/// observation, 30 ns.
///
/// A_i and Y_i take 192 bytes per observation with 9 columns. If all of them fit the last-level
/// cache, reading them takes a third of that time, and the elimination keeps them.

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

/// Calls visit(columns, part of the chunk) for the parts of an image.
template <typename Visit>
inline void VisitParts(const EliminationInput& input, const ModelGroup& group,
                       const Chunk::Image& image, const Visit& visit) {
  for (int kind = 0; kind < input.plan->num_kinds; ++kind) {
    if (image.part[kind] != Chunk::Image::kNone) visit(group.parts[kind], image.part[kind]);
  }
}

inline double SumOfQuad(const Quad& q) { return (q[0] + q[1]) + (q[2] + q[3]); }

/// `memory` has u_i of the observations of a point.
inline void MultiplyKept(const EliminationInput& input, const Chunk& chunk, const double* step,
                         double* memory, double* vectors) {
  constexpr int kAhead = 8, kLine = 8;  // observations whose records are on their way; doubles
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  const int64_t width = input.part_columns;
  const KeptRecords records(input);
  const auto group_of = [&](int64_t i) -> const ModelGroup& {
    return input.groups[input.image_group[plan.image.data()[i]]];
  };
  const auto image_of = [&](int64_t i) -> const Chunk::Image& {
    return chunk.images.data()[plan.image_in_chunk.data()[i]];
  };
  for (int p = chunk.first_point; p < chunk.last_point; ++p) {
    const int64_t end = begin[p] + CountRefined(input, begin[p], begin[p + 1]);
    Quad sum = {};
    double* u = memory;
    for (int64_t i = begin[p]; i < end; ++i, u += 2) {
      const double* const record = records.Of(i);
      for (int k = 0; k < records.stride(); k += kLine) {
        __builtin_prefetch(record + kAhead * records.stride() + k);
      }
      const ModelGroup& group = group_of(i);
      const int columns = KeptRecords::Columns(group);
      Quad along[2] = {};
      VisitParts(input, group, image_of(i), [&](const ModelGroup::Part& of, uint16_t part) {
        const double* const d = step + width * chunk.parts.data()[part];
        const double* const row = record + 4 * of.first_quad;
        for (int k = 0; k < 4 * of.num_quads; k += 4) {
          along[0] += LoadQuad(row + k) * LoadQuad(d + k);
          along[1] += LoadQuad(row + columns + k) * LoadQuad(d + k);
        }
      });
      for (int row = 0; row < 2; ++row) {
        u[row] = SumOfQuad(along[row]);
        sum += LoadQuad(record + 2 * columns + 3 * row) * u[row];
      }
    }
    double h[4];
    StoreQuad(sum, h);
    u = memory;
    for (int64_t i = begin[p]; i < end; ++i, u += 2) {
      const double* const record = records.Of(i);
      const ModelGroup& group = group_of(i);
      const int columns = KeptRecords::Columns(group);
      const double* const y = record + 2 * columns;
      const double rest_0 = u[0] - Dot3(y, h), rest_1 = u[1] - Dot3(y + 3, h);
      VisitParts(input, group, image_of(i), [&](const ModelGroup::Part& of, uint16_t part) {
        double* const to = vectors + width * part;
        const double* const row = record + 4 * of.first_quad;
        for (int k = 0; k < 4 * of.num_quads; k += 4) {
          StoreQuad(
              LoadQuad(to + k) + rest_0 * LoadQuad(row + k) + rest_1 * LoadQuad(row + columns + k),
              to + k);
        }
      });
    }
  }
}

/// With room for reading a quad at the end of the last record.
inline int64_t KeptDoubles(const EliminationInput& input) {
  return int64_t{KeptRecords::StrideOf(input)} * input.plan->num_observations() + 4;
}

}  // namespace bundle::BUNDLE_ISA
