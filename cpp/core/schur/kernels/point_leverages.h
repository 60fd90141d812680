#pragma once

/// Leverages of observations, given the covariance C of the camera parameters, and the rows of an
/// adjoint. Included by kernels.cpp only.
///
/// With the factors Z_a of a point's entries and the white rows Y_i of eliminate_point.h, A_i by
/// the camera parameters, T_i = A_i - Y_i Z^T and
///
///   h_i = Y_i Y_i^T + T_i C T_i^T
///       = A_i C A_i^T - (A_i X) Y_i^T - Y_i (A_i X)^T + Y_i (I + Z^T X) Y_i^T,       X = C Z.
///
/// X has a part per entry, X_a = sum_b C_ab Z_b. As in point_covariances.h, the pairs of a tile are
/// visited block by block of C; each adds to both of its entries, so that C_ab is needed in both
/// orders. A_i C A_i^T has the blocks of one image, and observations are visited image by image.
///
/// I + Z^T X is the covariance of the point in units of L^-1 (point_covariances.h).
///
/// An adjoint a of the camera parameters gives the rows (J~ a)_i = A_i a - Y_i Z^T a, without a
/// part of the points' own.

#include "core/schur/kernels/point_covariances.h"

namespace bundle::BUNDLE_ISA {

/// AddTimes for blocks of kRows rows, which stay in registers from pair to pair; 0: of any number.
template <int kQuads, int kRows>
void AddTimesOf(const double* z, int width, int64_t stride, const EntryPair* pairs, int count,
                bool is_back, int num_rows, const double* c, double* x) {
  using Row = WideRow<kQuads>;
  Row rows[kRows > 0 ? kRows : 1];
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) rows[r] = Row::Load(c + 4 * kQuads * r);
  for (const EntryPair* pair = pairs; pair < pairs + count; ++pair) {
    const double* const from = z + stride * (is_back ? pair->second : pair->first);
    double* const to = x + stride * (is_back ? pair->first : pair->second);
    Row sum[3];
    for (int k = 0; k < 3; ++k) sum[k] = Row::Load(to + 4 * kQuads * k);
#pragma GCC unroll 16
    for (int r = 0; r < kRows; ++r) {
      for (int k = 0; k < 3; ++k) sum[k].Add(from[width * k + r], rows[r]);
    }
    for (int r = kRows; r < num_rows; ++r) {
      const Row row = Row::Load(c + 4 * kQuads * r);
      for (int k = 0; k < 3; ++k) sum[k].Add(from[width * k + r], row);
    }
    for (int k = 0; k < 3; ++k) sum[k].Store(to + 4 * kQuads * k);
  }
}

/// X_b += C_ba Z_a for pairs (a, b) of entries, or X_a += C_ab Z_b if `is_back`. The block of C has
/// `num_rows` rows of kQuads quads, by the entry that is given; that one has rows of `width`.
template <int kQuads>
void AddTimes(const double* z, int width, int64_t stride, const EntryPair* pairs, int count,
              bool is_back, int num_rows, const double* c, double* x) {
  // Of a pose, and with two and three parameters. More do not fit into the registers.
  constexpr int kUsual = kQuads <= 2 ? 6 : kQuads == 3 ? 9 : 0, kWhole = kQuads == 2 ? 8 : kUsual;
  if (num_rows == kUsual) {
    AddTimesOf<kQuads, kUsual>(z, width, stride, pairs, count, is_back, kUsual, c, x);
  } else if (num_rows == kWhole) {
    AddTimesOf<kQuads, kWhole>(z, width, stride, pairs, count, is_back, kWhole, c, x);
  } else {
    AddTimesOf<kQuads, 0>(z, width, stride, pairs, count, is_back, num_rows, c, x);
  }
}

inline constexpr decltype(&AddTimes<1>) kAddTimes[] = {&AddTimes<1>, &AddTimes<2>, &AddTimes<3>,
                                                       &AddTimes<4>, &AddTimes<5>, &AddTimes<6>,
                                                       &AddTimes<7>};

/// Adds the products of kRows rows of a, `stride` apart, with kColumns rows of b, each in four
/// parts.
template <int kRows, int kColumns>
struct Dots {
  template <int kQuads>
  static void Add(const double* a, int stride, const double* b, Quad* sums) {
    using Row = WideRow<kQuads>;
    for (int i = 0; i < kRows; ++i) {
      const Row row = Row::Load(a + stride * i);
      for (int k = 0; k < kColumns; ++k) {
        sums[kColumns * i + k] += row.Times(Row::Load(b + 4 * kQuads * k));
      }
    }
  }
  static constexpr decltype(&Add<1>) kFor[] = {&Add<1>, &Add<2>, &Add<3>, &Add<4>,
                                               &Add<5>, &Add<6>, &Add<7>};
};

/// Adds a C b^T of the two rows of two parts of an observation, each in four parts.
template <int kQuads>
void AddQuadratic(const double* a, const double* b, int stride, int num_rows, const double* c,
                  Quad* sums) {
  using Row = WideRow<kQuads>;
  Row along[2] = {};
  for (int r = 0; r < num_rows; ++r) {
    const Row row = Row::Load(c + 4 * kQuads * r);
    for (int i = 0; i < 2; ++i) along[i].Add(a[stride * i + r], row);
  }
  for (int k = 0; k < 2; ++k) {
    const Row row = Row::Load(b + stride * k);
    for (int i = 0; i < 2; ++i) sums[2 * i + k] += along[i].Times(row);
  }
}

inline constexpr decltype(&AddQuadratic<1>) kAddQuadratic[] = {
    &AddQuadratic<1>, &AddQuadratic<2>, &AddQuadratic<3>, &AddQuadratic<4>,
    &AddQuadratic<5>, &AddQuadratic<6>, &AddQuadratic<7>};

inline double SumOf(const Quad& parts) { return (parts[0] + parts[1]) + (parts[2] + parts[3]); }

/// Numbers of a point: I + Z^T X, and -Z^T a.
struct SharedByPoint {
  double inner[3][3];
  double along[3];
};

/// Adds the point's part to A C A^T, of which the upper triangle is in h, and to A a. `head`:
/// white; `ax`: A X, 2 x 3.
inline void FinishLeverage(const double* head, const SharedByPoint& point, const double* ax,
                           ObservationLeverage* found) {
  double by[2][3];  // Y (I + Z^T X) - A X
  for (int i = 0; i < 2; ++i) {
    for (int k = 0; k < 3; ++k) {
      const double column[3] = {point.inner[0][k], point.inner[1][k], point.inner[2][k]};
      by[i][k] = Dot3(head + 4 * i, column) - ax[3 * i + k];
    }
    found->along[i] += Dot3(head + 4 * i, point.along);
    found->residual[i] = head[4 * i + 3];
  }
  for (int i = 0, at = 0; i < 2; ++i) {
    for (int k = i; k < 2; ++k, ++at) {
      found->h[at] += Dot3(by[i], head + 4 * k) - Dot3(head + 4 * i, ax + 3 * k);
    }
  }
}

/// Calls visit(number of the entry, index of its part in the chunk, whether it is single) for the
/// entries of a point.
template <typename Visit>
inline void ForEntries(const EliminationInput& input, const Chunk& chunk, int64_t begin,
                       int num_refined, const Visit& visit) {
  const int num_kinds = input.plan->num_kinds;
  const uint16_t* entry = input.plan->entry.data() + begin * num_kinds;
  const uint16_t* const image = input.plan->image_in_chunk.data() + begin;
  for (int i = 0; i < num_refined; ++i, entry += num_kinds) {
    for (int kind = 0; kind < num_kinds; ++kind) {
      const uint16_t part = chunk.images.data()[image[i]].part[kind];
      if (part == Chunk::Image::kNone || !IsFirstOfEntry(entry[kind])) continue;
      visit(EntryNumber(entry[kind]), part,
            kind == kOwnPart && IsSingle(entry, num_kinds, i + 1 == num_refined));
    }
  }
}

/// X of the entries of a tile.
inline void FormProducts(const EliminationInput& input, const Chunk& chunk, const TileCursor& at,
                         const Tile& tile, int last_point, const LeverageInput& given,
                         const double* z, double* products) {
  const int64_t* const begin = input.plan->first.data();
  const int* const parts = chunk.parts.data();
  const int64_t stride = int64_t{3} * input.part_columns;
  for (int p = at.first_point; p < last_point; ++p) {
    ForEntries(input, chunk, begin[p], CountRefined(input, begin[p], begin[p + 1]),
               [&](uint16_t number, uint16_t slot, bool is_single) {
                 double* const to = products + stride * number;
                 for (int64_t k = 0; k < stride; ++k) to[k] = 0;
                 if (!is_single) return;
                 const EntryPair pair = {number, number};
                 const int part = parts[slot], quads = input.part_quads[part];
                 kAddTimes[quads - 1](z, 4 * quads, stride, &pair, 1, false, input.part_rows[part],
                                      given.blocks + given.block_begin[slot], products);
               });
  }
  const auto num_parts = static_cast<int64_t>(chunk.parts.size());
  const EntryPair* pairs = at.pairs;
  for (const Tile::Block* of = at.block; of < at.EndOfBlocks(tile); ++of) {
    const Chunk::Pair pair = PartsOfBlock(chunk, of->block);
    const int first = parts[pair.first], second = parts[pair.second];
    const int first_quads = input.part_quads[first], second_quads = input.part_quads[second];
    kAddTimes[second_quads - 1](z, 4 * first_quads, stride, pairs, of->num_pairs, false,
                                input.part_rows[first], given.blocks + given.block_begin[of->block],
                                products);
    if (of->block >= num_parts) {
      const int64_t back = chunk.num_blocks() + of->block - num_parts;
      kAddTimes[first_quads - 1](z, 4 * second_quads, stride, pairs, of->num_pairs, true,
                                 input.part_rows[second], given.blocks + given.block_begin[back],
                                 products);
    }
    pairs += of->num_pairs;
  }
}

/// The numbers of a point, from its entries.
inline SharedByPoint ShareOfPoint(const EliminationInput& input, const Chunk& chunk, int64_t begin,
                                  int num_refined, const LeverageInput& given, const double* z,
                                  const double* products) {
  const int64_t stride = int64_t{3} * input.part_columns;
  Quad inner[9] = {}, along[3] = {};
  ForEntries(input, chunk, begin, num_refined, [&](uint16_t number, uint16_t slot, bool) {
    const int part = chunk.parts.data()[slot], quads = input.part_quads[part];
    const double* const of = z + stride * number;
    if (given.blocks != nullptr) {
      Dots<3, 3>::kFor[quads - 1](of, 4 * quads, products + stride * number, inner);
    }
    if (given.adjoint != nullptr) {
      Dots<3, 1>::kFor[quads - 1](of, 4 * quads, given.adjoint + input.part_columns * part, along);
    }
  });
  SharedByPoint point;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) point.inner[i][k] = (i == k ? 1 : 0) + SumOf(inner[3 * i + k]);
    point.along[i] = -SumOf(along[i]);
  }
  return point;
}

/// A C A^T, A X and A a of an observation of an image.
inline void AddCameraRows(const EliminationInput& input, const Chunk& chunk,
                          const ModelGroup& group, const Chunk::Image& image, const double* record,
                          const uint16_t* entry, const LeverageInput& given, const double* products,
                          double* ax, ObservationLeverage* found) {
  const int row = 4 * group.num_quads, num_kinds = input.plan->num_kinds;
  const int64_t stride = int64_t{3} * input.part_columns;
  Quad by_products[6] = {}, own[4] = {}, cross[4] = {}, along[2] = {};
  for (int kind = 0; kind < num_kinds; ++kind) {
    const uint16_t slot = image.part[kind];
    if (slot == Chunk::Image::kNone) continue;
    const ModelGroup::Part& of = group.parts[kind];
    const double* const a = record + kRecordHead + 4 * of.first_quad;
    if (given.adjoint != nullptr) {
      Dots<2, 1>::kFor[of.num_quads - 1](
          a, row, given.adjoint + input.part_columns * chunk.parts.data()[slot], along);
    }
    if (given.blocks == nullptr) continue;
    Dots<2, 3>::kFor[of.num_quads - 1](a, row, products + stride * EntryNumber(entry[kind]),
                                       by_products);
    kAddQuadratic[of.num_quads - 1](a, a, row, of.num_columns,
                                    given.blocks + given.block_begin[slot], own);
    for (int other = kind + 1; other < num_kinds; ++other) {
      if (image.part[other] == Chunk::Image::kNone) continue;
      const ModelGroup::Part& with = group.parts[other];
      kAddQuadratic[with.num_quads - 1](
          a, record + kRecordHead + 4 * with.first_quad, row, of.num_columns,
          given.blocks + given.block_begin[image.cross[CrossIndex(kind, other)]], cross);
    }
  }
  for (int k = 0; k < 6; ++k) ax[k] = SumOf(by_products[k]);
  for (int i = 0; i < 2; ++i) found->along[i] = SumOf(along[i]);
  found->h[0] = SumOf(own[0] + 2 * cross[0]);
  found->h[1] = SumOf(own[1] + cross[1] + cross[2]);
  found->h[2] = SumOf(own[3] + 2 * cross[3]);
}

/// Residuals without the weights of the loss.
inline void WriteResiduals(const EliminationInput& input, const StateRecords& x, int first_point,
                           int last_point, ObservationLeverage* found) {
  const int64_t first = input.plan->first.data()[first_point];
  for (int point = first_point; point < last_point;) {
    const Strip strip(input, point, last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      const LaneState state(input, x, lanes, false);
      const LaneResiduals residuals(input, x, state, lanes, false);
      for (int lane = 0; lane < lanes.count; ++lane) {
        double* const to = found[lanes.observation[lane] - first].residual;
        for (int i = 0; i < 2; ++i) to[i] = residuals.r[i].v[lane];
      }
    });
    point = strip.last;
  }
}

inline void PointLeverages(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                           const LeverageInput& given, double* memory, ObservationLeverage* found,
                           double* covariances) {
  if (chunk.last_row > 0) return;
  const EliminationPlan& plan = *input.plan;
  const int64_t* const begin = plan.first.data();
  const int num_free = plan.num_free_points;
  double* const products = memory + TileDoubles(input);
  const ScatterMemory tile_memory(plan, products + TileRecords::FactorDoubles(input));
  auto* const shared = reinterpret_cast<SharedByPoint*>(tile_memory.sums);
  static_assert(sizeof(SharedByPoint) <= 9 * sizeof(Quad));
  const auto result = [&](int64_t i) { return found + (i - begin[chunk.first_point]); };
  TileCursor at = {chunk};
  for (const Tile* tile = chunk.tiles.data(); at.first_point < chunk.last_point; ++tile) {
    const int first_point = at.first_point;
    const int last_point = tile->last_point < num_free ? tile->last_point : num_free;
    if (first_point >= last_point) break;
    const TileRecords records(input, memory, first_point);
    FormTile(input, x, chunk, first_point, last_point, records, memory, tile_memory,
             [&](int p, const PointBlock& block) {
               for (int k = 0; k < 3; ++k) {
                 tile_memory.columns[3 * (p - first_point) + k] = block.column[k];
               }
               for (int64_t i = begin[p] + CountRefined(input, begin[p], begin[p + 1]);
                    i < begin[p + 1]; ++i) {
                 WhitenHead(block, records.Of(i));
               }
             });
    if (given.blocks != nullptr) {
      FormProducts(input, chunk, at, *tile, last_point, given, memory, products);
    }
    for (int p = first_point; p < last_point; ++p) {
      const int num_refined = CountRefined(input, begin[p], begin[p + 1]);
      SharedByPoint* const of = shared + (p - first_point);
      *of = ShareOfPoint(input, chunk, begin[p], num_refined, given, memory, products);
      if (covariances != nullptr) {
        PointBlock block;
        for (int k = 0; k < 3; ++k)
          block.column[k] = tile_memory.columns[3 * (p - first_point) + k];
        Unwhiten(block, of->inner, covariances + 9 * int64_t{p - chunk.first_point});
      }
      for (int64_t i = begin[p] + num_refined; i < begin[p + 1]; ++i) {
        constexpr double kNone[6] = {};
        *result(i) = {};
        FinishLeverage(records.Of(i), *of, kNone, result(i));
      }
    }
    const int64_t first = begin[first_point], num_observations = begin[last_point] - first;
    ForImages(input, at.image, at.EndOfImages(*tile), at.observations, first, records, 0,
              [&](const ModelGroup& group, const Tile::Image& number, const ImageRecords& of) {
                const Chunk::Image& image = chunk.images.data()[number.image];
                int kind = 0;
                while (image.part[kind] == Chunk::Image::kNone) ++kind;
                for (int k = 0; k < of.count && of.observations[k] < num_observations; ++k) {
                  const int64_t i = first + of.observations[k];
                  const uint16_t* const entry = plan.entry.data() + i * plan.num_kinds;
                  double ax[6];
                  AddCameraRows(input, chunk, group, image, records.Of(i), entry, given, products,
                                ax, result(i));
                  FinishLeverage(records.Of(i),
                                 shared[tile_memory.point_of_entry[EntryNumber(entry[kind])]], ax,
                                 result(i));
                }
              });
    at.Pass(*tile);
  }
  const int last_point = chunk.last_point < num_free ? chunk.last_point : num_free;
  if (input.loss == LossType::kTrivial || chunk.first_point >= last_point) return;
  WriteResiduals(input, x, chunk.first_point, last_point, found);
}

}  // namespace bundle::BUNDLE_ISA
