#pragma once

/// Products of a tile, summed block by block. Included by kernels.cpp only.
///
///   S_ab -= W_pa W_pb^T       for the pairs of entries of each point p, of rank 3
///   S_aa += A_ia^T M A_ia     for the observations i of an image, of rank 2
///   S_ab += A_ia^T A_ib       for two parts of the image
///
/// If every product were added to its block in memory, loads and stores would take longer than the
/// arithmetic. Here the rows of a block stay in registers while all products of a tile are added,
/// and the factors come from the second-level cache. If a block has more rows than there are
/// registers, its panels of rows are computed one after the other.

#include "core/parallel/pack.h"
#include "core/schur/kernels/eliminate_point.h"
#include "core/schur/kernels/nine_products.h"
#include "core/schur/kernels/twelve_products.h"
#include "core/schur/kernels/wide_row.h"

namespace bundle::BUNDLE_ISA {

/// Rows of a panel that fits into the registers: AVX-512 and NEON have 32 registers, others 16.
template <int kQuads>
constexpr int PanelRows() {
  if (kLanes == 8) return kQuads <= 2 ? 12 : kQuads <= 4 ? 9 : 6;
#if defined(__AVX__) || defined(__aarch64__)
  constexpr int kQuadsInRegisters = 12;
#else
  constexpr int kQuadsInRegisters = 6;
#endif
  return kQuads < kQuadsInRegisters ? kQuadsInRegisters / kQuads : 1;
}
template <int kQuads>
inline constexpr int kPanelRows = PanelRows<kQuads>();

/// Subtracts the products of `count` pairs from kRows rows of a block. Entries have `stride`
/// doubles, of which a row takes `width` in the first factor and 4 kQuads in the second.
template <int kQuads, int kRows>
void SubtractPanel(const double* first, int width, const double* second, int64_t stride,
                   const EntryPair* pairs, int count, int64_t last_bit, double* block) {
  WideRow<kQuads> sum[kRows];
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) sum[r] = WideRow<kQuads>::Load(block + 4 * kQuads * r);
  for (int i = 0; i < count; ++i) {
    const double* const a = first + stride * pairs[i].first;
    const double* const b = second + stride * pairs[i].second;
    if constexpr (!kFuses) {
#pragma GCC unroll 16
      for (int r = 0; r < kRows; ++r) {
        WideRow<kQuads> term = {};
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k) {
          term.Subtract(a[width * k + r], WideRow<kQuads>::Load(b + 4 * kQuads * k));
        }
        sum[r].AddTerm(term, last_bit);
      }
      continue;
    }
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
      const auto row = WideRow<kQuads>::Load(b + 4 * kQuads * k);
#pragma GCC unroll 16
      for (int r = 0; r < kRows; ++r) sum[r].Subtract(a[width * k + r], row);
    }
  }
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) sum[r].Store(block + 4 * kQuads * r);
}

/// The observations of one image in a tile, and its records.
struct ImageRecords {
  const double* first;           ///< record of the tile's first observation
  int64_t stride;                ///< between records
  int row_stride;                ///< from row 0 to row 1
  const uint16_t* observations;  ///< numbers in the tile
  int count;
  int64_t last_bit;  ///< ChunkSum::last_bit
};

/// Adds A_a^T M A_b of all observations to kRows rows of a block, where the rows of A_a begin at
/// `first` doubles from the begin of the record and those of A_b at `second`. `kHasMiddle`: M is
/// that of the record's head; or else M = I.
template <int kQuads, int kRows, bool kHasMiddle>
void AddPanel(const ImageRecords& records, int first, int second, double* block) {
  WideRow<kQuads> sum[kRows];
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) sum[r] = WideRow<kQuads>::Load(block + 4 * kQuads * r);
  for (int i = 0; i < records.count; ++i) {
    const double* const record = records.first + records.stride * records.observations[i];
    const double *a_0 = record + first, *a_1 = a_0 + records.row_stride;
    auto row_0 = WideRow<kQuads>::Load(record + second);
    auto row_1 = WideRow<kQuads>::Load(record + second + records.row_stride);
    if constexpr (kHasMiddle) {
      const double* const m = record + 4;
      WideRow<kQuads> middle_0 = {}, middle_1 = {};
      middle_0.Add(m[0], row_0);
      middle_0.Add(m[1], row_1);
      middle_1.Add(m[1], row_0);
      middle_1.Add(m[2], row_1);
      row_0 = middle_0;
      row_1 = middle_1;
    }
#pragma GCC unroll 16
    for (int r = 0; r < kRows; ++r) {
      sum[r].AddTwo(a_0[r], row_0, a_1[r], row_1, records.last_bit);
    }
  }
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) sum[r].Store(block + 4 * kQuads * r);
}

/// Adds A^T r, A^T (r - Y h) and ||A e_j||^2 of all observations to three vectors. The columns
/// begin at `first` doubles from the begin of the record.
template <int kQuads>
void AddVectors(const ImageRecords& records, int first, double* vectors) {
  using Row = WideRow<kQuads>;
  Row sum[ChunkSum::kVectors];
  for (int v = 0; v < ChunkSum::kVectors; ++v) sum[v] = Row::Load(vectors + 4 * kQuads * v);
  for (int i = 0; i < records.count; ++i) {
    const double* const record = records.first + records.stride * records.observations[i];
    const Row row_0 = Row::Load(record + first);
    const Row row_1 = Row::Load(record + first + records.row_stride);
    for (int v = 0; v < 2; ++v) {
      sum[v].AddTwo(record[2 * v], row_0, record[2 * v + 1], row_1, records.last_bit);
    }
    sum[2].AddTwoSquares(row_0, row_1, records.last_bit);
  }
  for (int v = 0; v < ChunkSum::kVectors; ++v) sum[v].Store(vectors + 4 * kQuads * v);
}

/// The functions for panels of at most kRows rows, by their height minus one.
template <int kQuads, int kRows>
struct Panels {
  template <int... kHeight>
  struct List {
    static constexpr decltype(&SubtractPanel<1, 1>) kSubtract[] = {
        &SubtractPanel<kQuads, kHeight + 1>...};
    static constexpr decltype(&AddPanel<1, 1, true>) kAdd[] = {
        &AddPanel<kQuads, kHeight + 1, false>...};
    static constexpr decltype(&AddPanel<1, 1, true>) kAddWithMiddle[] = {
        &AddPanel<kQuads, kHeight + 1, true>...};
  };
  template <int... kHeight>
  static List<kHeight...> Make(std::integer_sequence<int, kHeight...>);
  using Type = decltype(Make(std::make_integer_sequence<int, kRows>()));
};
template <int kQuads>
using PanelsFor = typename Panels<kQuads, kPanelRows<kQuads>>::Type;

/// Calls visit(first row, height) for panels of about equal heights.
template <int kQuads, typename Visit>
inline void ForPanels(int num_rows, const Visit& visit) {
  constexpr int kMost = kPanelRows<kQuads>;
  const int panels = (num_rows + kMost - 1) / kMost;
  for (int panel = 0, row = 0; panel < panels; ++panel) {
    const int height = (num_rows - row + panels - panel - 1) / (panels - panel);
    visit(row, height);
    row += height;
  }
}

/// block += sum of A_a^T M A_b; `num_rows` rows of kQuads quads.
template <int kQuads>
void AddProducts(const ImageRecords& records, int first, int second, bool has_middle, int num_rows,
                 double* block) {
  using Functions = PanelsFor<kQuads>;
  ForPanels<kQuads>(num_rows, [&](int row, int height) {
    const auto add =
        has_middle ? Functions::kAddWithMiddle[height - 1] : Functions::kAdd[height - 1];
    add(records, first + row, second, block + 4 * kQuads * row);
  });
}

/// block -= sum of W_a W_b^T over pairs of entries; `num_rows` rows of kQuads quads.
template <int kQuads>
void SubtractPairs(const double* w, int width, int64_t stride, const EntryPair* pairs, int count,
                   int64_t last_bit, int num_rows, double* block) {
  ForPanels<kQuads>(num_rows, [&](int row, int height) {
    PanelsFor<kQuads>::kSubtract[height - 1](w + row, width, w, stride, pairs, count, last_bit,
                                             block + 4 * kQuads * row);
  });
}

/// Functions by the quads of a block's rows, minus one.
inline constexpr decltype(&SubtractPairs<1>) kSubtractPairs[] = {
    &SubtractPairs<1>, &SubtractPairs<2>, &SubtractPairs<3>, &SubtractPairs<4>,
    &SubtractPairs<5>, &SubtractPairs<6>, &SubtractPairs<7>};
inline constexpr decltype(&AddProducts<1>) kAddProducts[] = {
    &AddProducts<1>, &AddProducts<2>, &AddProducts<3>, &AddProducts<4>,
    &AddProducts<5>, &AddProducts<6>, &AddProducts<7>};
inline constexpr decltype(&AddVectors<1>) kAddVectors[] = {
    &AddVectors<1>, &AddVectors<2>, &AddVectors<3>, &AddVectors<4>,
    &AddVectors<5>, &AddVectors<6>, &AddVectors<7>};

/// block += sum of A^T M A of the columns of a part, upper triangle.
inline void AddOwnProducts(const ImageRecords& records, int first, bool has_middle,
                           const ModelGroup::Part& of, double* block) {
  if (kLanes == 8 && of.num_columns == 9) {
    (has_middle ? AddNine<true, ImageRecords> : AddNine<false, ImageRecords>)(records, first,
                                                                              block);
  } else if (kLanes == 8 && of.num_columns == 12) {
    (has_middle ? AddTwelve<true, ImageRecords> : AddTwelve<false, ImageRecords>)(records, first,
                                                                                  block);
  } else {
    kAddProducts[of.num_quads - 1](records, first, first, has_middle, of.num_columns, block);
  }
}

/// Adds the diagonal products of the observations of one image.
inline void AddImage(const EliminationInput& input, const ModelGroup& group,
                     const Chunk::Image& image, const ImageRecords& records, const ChunkSum& sum) {
  for (int kind = 0; kind < input.plan->num_kinds; ++kind) {
    const uint16_t part = image.part[kind];
    if (part == Chunk::Image::kNone) continue;
    const ModelGroup::Part& of = group.parts[kind];
    const int first = kRecordHead + 4 * of.first_quad;
    const int64_t begin = sum.block_begin[part];
    kAddVectors[of.num_quads - 1](
        records, first, sum.vectors + int64_t{ChunkSum::kVectors} * input.part_columns * part);
    AddOwnProducts(records, first, kind == kOwnPart, of, sum.blocks + begin);
    if (sum.camera_diagonal != nullptr) {
      AddOwnProducts(records, first, false, of, sum.camera_diagonal + begin);
    }
    for (int other = kind + 1; other < input.plan->num_kinds; ++other) {
      if (image.part[other] == Chunk::Image::kNone) continue;
      const ModelGroup::Part& with = group.parts[other];
      kAddProducts[with.num_quads - 1](
          records, first, kRecordHead + 4 * with.first_quad, false, of.num_columns,
          sum.blocks + sum.block_begin[image.cross[CrossIndex(kind, other)]]);
    }
  }
}

/// Calls visit(group, image, its records) for the images of a tile.
template <typename Visit>
inline void ForImages(const EliminationInput& input, const Tile::Image* begin,
                      const Tile::Image* end, const uint16_t* observations, int64_t first,
                      const TileRecords& records, int64_t last_bit, const Visit& visit) {
  for (const Tile::Image* at = begin; at < end; ++at) {
    const int image = input.plan->image.data()[first + *observations];
    const ModelGroup& group = input.groups[input.image_group[image]];
    visit(group, *at,
          ImageRecords{records.Of(first), records.stride(), 4 * group.num_quads, observations,
                       at->num_observations, last_bit});
    observations += at->num_observations;
  }
}

/// Adds the diagonal products of the images of a tile.
inline void AddImages(const EliminationInput& input, const Chunk& chunk, const Tile::Image* begin,
                      const Tile::Image* end, const uint16_t* observations, int64_t first,
                      const TileRecords& records, const ChunkSum& sum) {
  ForImages(input, begin, end, observations, first, records, sum.last_bit,
            [&](const ModelGroup& group, const Tile::Image& image, const ImageRecords& of) {
              AddImage(input, group, chunk.images.data()[image.image], of, sum);
            });
}

/// The parts of a block of a chunk.
inline Chunk::Pair PartsOfBlock(const Chunk& chunk, uint16_t block) {
  const auto num_parts = static_cast<int64_t>(chunk.parts.size());
  if (block < num_parts) return {block, block};
  return chunk.pairs.data()[block - num_parts];
}

/// The pairs of a tile, whose entries have the factors `w`.
inline void SubtractTile(const EliminationInput& input, const Chunk& chunk,
                         const Tile::Block* begin, const Tile::Block* end, const EntryPair* pairs,
                         const double* w, const ChunkSum& sum) {
  const int* const parts = chunk.parts.data();
  const int64_t stride = int64_t{3} * input.part_columns;
  for (const Tile::Block* at = begin; at < end; ++at) {
    const Chunk::Pair of = PartsOfBlock(chunk, at->block);
    const int first = parts[of.first], second = parts[of.second];
    double* const block = sum.blocks + sum.block_begin[at->block];
    if (kLanes == 8 && input.part_rows[first] == 9 && input.part_rows[second] == 9) {
      SubtractNine(w, stride, pairs, at->num_pairs, block);
    } else if (kLanes == 8 && input.part_rows[first] == 12 && input.part_rows[second] == 12) {
      SubtractTwelve(w, stride, pairs, at->num_pairs, block);
    } else {
      kSubtractPairs[input.part_quads[second] - 1](w, 4 * input.part_quads[first], stride, pairs,
                                                   at->num_pairs, sum.last_bit,
                                                   input.part_rows[first], block);
    }
    pairs += at->num_pairs;
  }
}

}  // namespace bundle::BUNDLE_ISA
