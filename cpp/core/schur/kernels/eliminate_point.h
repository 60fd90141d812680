#pragma once

/// Elimination of a point. Included by kernels.cpp only.
///
/// For a point with damped block V' = V + damping D^2 = L L^T and observations i, whose corrected
/// residuals and Jacobians are r_i, A_i (camera parameters) and B_i (point, 2x3), the Schur
/// complement of V' in the normal equations is, with Y_i = B_i L^-T and h = L^-1 g,
///
///   S = sum A_i^T A_i - W W^T,    W = sum A_i^T Y_i,    b -= sum A_i^T (r_i - Y_i h).
///
/// A part a of the camera parameters (schur/image_parts.h) has the columns A_ia of A_i and the rows
/// W_a of W, d x 3. W_a is the factor of one entry of the point: a sum over all its observations
/// that depend on a. So
///
///   S_ab += sum A_ia^T A_ib    for two parts of one image,
///   S_ab -= W_a W_b^T          for every pair of entries (tile_products.h).
///
/// A camera that all images share is one entry. Its columns are then multiplied once per point, not
/// once per pair of observations.
///
/// An own part is usually in one observation i only. Then W_a = A_ia^T Y_i, and its diagonal block
/// is
///
///   S_aa += A_ia^T (I - Y_i Y_i^T) A_ia,
///
/// which costs as much as A_ia^T A_ia alone. For d = 9
///
///   an observation its projection and derivatives, about 400 flops, kLanes at a time;
///                  S_aa: 45 x 4 flops, W_a: 9 x 9 flops,
///   a pair         81 x 6 flops.
///
/// The diagonal products of observations are summed per image of a tile, like those of the pairs
/// (tile_products.h). For this, the head of its record is replaced by
///
///   r_0 r_1, the entries of r - Y h, and the upper triangle of I - Y Y^T or I.

#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/wide_row.h"

namespace bundle::BUNDLE_ISA {

/// Number of doubles in a record before the two rows of the camera parameters: (a, r) of each row.
inline constexpr int kRecordHead = 8;
inline constexpr int kMaxRecordQuads = sizeof(ModelGroup::columns) / 4;
inline constexpr int kMaxQuads = (kImageColumns + 3) / 4;  ///< most quads of a part

/// Records of a tile: [a_0 r_0 | a_1 r_1 | row 0 | row 1] per observation. The rows are as wide as
/// those of the image's group. All records have the length of the widest.
class TileRecords {
 public:
  /// `memory`: that of a pass. The factors of the tile's entries come first. `first_point`: that of
  /// the tile.
  TileRecords(const EliminationInput& input, double* memory, int first_point)
      : stride_(StrideOf(input)),
        data_(memory + FactorDoubles(input) -
              input.plan->first.data()[first_point] * int64_t{stride_}) {}

  static int64_t FactorDoubles(const EliminationInput& input) {
    return int64_t{3} * input.part_columns * input.plan->largest_tile_entries;
  }
  static int StrideOf(const EliminationInput& input) {
    return kRecordHead + 2 * input.record_columns;
  }

  int stride() const { return stride_; }
  /// `observation`: index in the plan.
  double* Of(int64_t observation) const { return data_ + observation * stride_; }
  const double* Rows(int64_t observation) const { return Of(observation) + kRecordHead; }

 private:
  int stride_;
  double* data_;
};

/// Records that the elimination keeps for products with S (multiply_schur.h): [row 0 | row 1 | y_0
/// | y_1] per observation of the plan, without padding after a row; y is 0 for constant points.
class KeptRecords {
 public:
  explicit KeptRecords(const EliminationInput& input)
      : stride_(StrideOf(input)), data_(input.kept_records) {}

  /// Doubles from row 0 to row 1.
  static int Columns(const ModelGroup& group) {
    int columns = 0;
    for (const ModelGroup::Part& part : group.parts) {
      if (part.num_columns > 0) columns = 4 * part.first_quad + part.num_columns;
    }
    return columns;
  }
  static int StrideOf(const EliminationInput& input) {
    int columns = 0;
    for (int g = 0; g < input.num_groups; ++g) {
      const int of_group = Columns(input.groups[g]);
      if (of_group > columns) columns = of_group;
    }
    return 2 * columns + 6;
  }

  int stride() const { return stride_; }
  double* Of(int64_t observation) const { return data_ + observation * stride_; }

  /// `record`: with a white head unless the point is constant. Not inlined, so that the code of an
  /// elimination that keeps none does not change.
  __attribute__((noinline)) static void Keep(const EliminationInput& input, int64_t observation,
                                             const double* record, bool is_constant) {
    const ModelGroup& group =
        input.groups[input.image_group[input.plan->image.data()[observation]]];
    double* const to = KeptRecords(input).Of(observation);
    const int columns = Columns(group), width = 4 * group.num_quads;
    for (int row = 0; row < 2; ++row) {
      const double* const from = record + kRecordHead + row * width;
      for (int k = 0; k < width; k += 4) StoreQuad(LoadQuad(from + k), to + row * columns + k);
    }
    for (int j = 0; j < 6; ++j) {
      to[2 * columns + j] = is_constant ? 0 : record[j < 3 ? j : j + 1];
    }
  }

 private:
  int stride_;
  double* data_;
};

/// Replaces the head (a, r) of a record by (y, r).
inline void WhitenHead(const PointBlock& block, double* head) {
  for (double* at = head; at < head + kRecordHead; at += 4) {
    Quad y = block.Whiten(LoadQuad(at));
    y[3] = at[3];
    StoreQuad(y, at);
  }
}

/// Number of refined images among a point's observations [begin, end); these come first.
inline int CountRefined(const EliminationInput& input, int64_t begin, int64_t end) {
  while (end > begin && input.image_refined[input.plan->image.data()[end - 1]] == 0) --end;
  return static_cast<int>(end - begin);
}

inline bool IsFirstOfEntry(uint16_t entry) { return (entry & EliminationPlan::kFirstOfEntry) != 0; }

inline uint16_t EntryNumber(uint16_t entry) {
  return entry & static_cast<uint16_t>(EliminationPlan::kFirstOfEntry - 1);
}

/// True if the own part of an observation is in no other observation of its point. `entry`: that of
/// its own part; the next observation is `num_kinds` numbers further on.
inline bool IsSingle(const uint16_t* entry, int num_kinds, bool is_last) {
  return IsFirstOfEntry(entry[0]) && (is_last || IsFirstOfEntry(entry[num_kinds]));
}

/// w = A^T Y, or w += A^T Y unless `is_first`; three rows, one per column of Y.
template <int kQuads>
void AddFactor(const double* rows, int stride, const double* head, bool is_first, double* w) {
  using Row = WideRow<kQuads>;
  const Row row_0 = Row::Load(rows), row_1 = Row::Load(rows + stride);
  for (int k = 0; k < 3; ++k, w += 4 * kQuads) {
    Row sum = is_first ? Row{} : Row::Load(w);
    sum.Add(head[k], row_0);
    sum.Add(head[4 + k], row_1);
    sum.Store(w);
  }
}

inline constexpr decltype(&AddFactor<1>) kAddFactor[] = {
    &AddFactor<1>, &AddFactor<2>, &AddFactor<3>, &AddFactor<4>,
    &AddFactor<5>, &AddFactor<6>, &AddFactor<7>};

/// Adds an observation with a white record to the factors `w` of its entries. kOwn, kCamera: quads
/// of the parts of every image (EliminationInput::own_quads), or 0 and 0.
template <int kOwn, int kCamera>
inline void AddFactors(const EliminationInput& input, const ModelGroup& group,
                       const Chunk::Image& image, const double* record, const uint16_t* entry,
                       double* w) {
  const double* const rows = record + kRecordHead;
  const auto w_of = [&](int kind) {
    return w + int64_t{3} * input.part_columns * EntryNumber(entry[kind]);
  };
  if constexpr (kOwn > 0) {
    constexpr int kStride = 4 * (kOwn + kCamera);
    if (image.part[kOwnPart] != Chunk::Image::kNone) {
      AddFactor<kOwn>(rows, kStride, record, IsFirstOfEntry(entry[kOwnPart]), w_of(kOwnPart));
    }
    if constexpr (kCamera > 0) {
      if (image.part[kCameraPart] == Chunk::Image::kNone) return;
      AddFactor<kCamera>(rows + 4 * kOwn, kStride, record, IsFirstOfEntry(entry[kCameraPart]),
                         w_of(kCameraPart));
    }
  } else {
    for (int kind = 0; kind < input.plan->num_kinds; ++kind) {
      if (image.part[kind] == Chunk::Image::kNone) continue;
      const ModelGroup::Part& part = group.parts[kind];
      kAddFactor[part.num_quads - 1](rows + 4 * part.first_quad, 4 * group.num_quads, record,
                                     IsFirstOfEntry(entry[kind]), w_of(kind));
    }
  }
}

/// Replaces the head (y, r) of a record by the numbers for the observation's diagonal products.
/// `h`: 3 numbers of the point's block.
inline void FinishHead(const double* h, bool is_single, double* head) {
  const double *y_0 = head, *y_1 = head + 4;
  const double r_0 = y_0[3], r_1 = y_1[3];
  const Quad residuals = {r_0, r_1, r_0 - Dot3(y_0, h), r_1 - Dot3(y_1, h)};
  Quad middle = {1, 0, 1, 0};
  if (is_single) middle -= Quad{Dot3(y_0, y_0), Dot3(y_0, y_1), Dot3(y_1, y_1), 0};
  StoreQuad(residuals, head);
  StoreQuad(middle, head + 4);
}

/// FinishHead for all observations of a constant point; their heads are (a, r).
inline void FinishConstantHeads(const TileRecords& records, int64_t begin, int num_refined) {
  for (int64_t i = begin; i < begin + num_refined; ++i) {
    double* const head = records.Of(i);
    const Quad residuals = {head[3], head[7], head[3], head[7]};
    StoreQuad(residuals, head);
    StoreQuad(Quad{1, 0, 1, 0}, head + 4);
  }
}

/// Whitens the heads of a point's records, from observation `begin` on, calls visit(observation,
/// record, its entries), and with kFinish finishes the heads. `num_kinds`: that of the plan.
template <bool kFinish, typename Visit>
inline void VisitHeads(const EliminationInput& input, const TileRecords& records, int64_t begin,
                       int num_refined, int num_kinds, const PointBlock& block,
                       const Visit& visit) {
  const uint16_t* entry = input.plan->entry.data() + begin * num_kinds;
  double h[4];
  StoreQuad(block.h, h);
  for (int i = 0; i < num_refined; ++i, entry += num_kinds) {
    double* const record = records.Of(begin + i);
    WhitenHead(block, record);
    visit(begin + i, record, entry);
    if constexpr (kFinish) FinishHead(h, IsSingle(entry, num_kinds, i + 1 == num_refined), record);
  }
}

/// VisitHeads that computes the factors of the point's entries.
template <int kOwn, int kCamera, bool kFinish>
inline void FormFactors(const EliminationInput& input, const Chunk& chunk,
                        const TileRecords& records, int64_t begin, int num_refined,
                        const PointBlock& block, double* w) {
  const EliminationPlan& plan = *input.plan;
  const int num_kinds = kOwn == 0 ? plan.num_kinds : kCamera > 0 ? 2 : 1;
  VisitHeads<kFinish>(input, records, begin, num_refined, num_kinds, block,
                      [&](int64_t i, const double* record, const uint16_t* entry) {
                        if (kFinish && input.kept_records != nullptr) {
                          KeptRecords::Keep(input, i, record, /*is_constant=*/false);
                        }
                        const int group = kOwn > 0 ? 0 : input.image_group[plan.image.data()[i]];
                        AddFactors<kOwn, kCamera>(
                            input, input.groups[group],
                            chunk.images.data()[plan.image_in_chunk.data()[i]], record, entry, w);
                      });
}

}  // namespace bundle::BUNDLE_ISA
