#pragma once

/// The elimination of a point; kernels_impl.h says how to include this.
///
/// Of a point with damped block V' = V + damping D^2 = L L^T and observations i, whose corrected
/// residuals and Jacobians are r_i, A_i (camera side, 2 x d) and B_i (point, 2x3), the Schur
/// complement of V' in the normal equations adds, with Y_i = B_i L^-T and h = L^-1 g,
///
///   S_ij += A_i^T (delta_ij I - B_i V'^-1 B_j^T) A_j = A_i^T (delta_ij I - Y_i Y_j^T) A_j,
///   b_i  -= A_i^T (r_i - B_i V'^-1 g)                = A_i^T (r_i - Y_i h).
///
/// Ceres' eliminator forms W_i = A_i^T B_i (d x 3) and the products W_i V'^-1 W_j^T, of rank 3. The
/// 2x2 matrix in the middle makes them products of rank 2, unites A_i^T A_i with the diagonal ones,
/// and subtracts pixels from pixels before anything grows: for d = 9
///
///   an observation    its projection and derivatives, about 400 flops, kLanes at a time;
///                     S_ii: 45 x 4 flops,
///   a pair            Y_i Y_j^T: 20, times A_i: 54, S_ij: 81 x 4 flops.
///
/// The records of a strip, 2 d + 8 doubles an observation, live in the first-level cache.

#include "core/fused/eliminate/block_products.h"
#include "core/fused/eliminate/point_block.h"

namespace bundle::fused::BUNDLE_ISA {

inline constexpr int kMaxColumns = (kPoseSize + kMaxCameraParams + 3) / 4 * 4;
/// Doubles of a record beyond two rows of the camera side: (a, r) of each row.
inline constexpr int kRecordTail = 8;

/// Records of a strip: [row 0 | row 1 | a_0 r_0 | a_1 r_1] an observation, the rows as wide as the
/// image's group and the rest where the widest has it.
class StripRecords {
 public:
  StripRecords(const Terms& terms, double* memory)
      : columns_(terms.num_columns), stride_(2 * terms.num_columns + kRecordTail), data_(memory) {}

  int stride() const { return stride_; }
  double* Of(int64_t slot) const { return data_ + slot * stride_; }
  double* Tail(int64_t slot) const { return Of(slot) + 2 * columns_; }

 private:
  int columns_, stride_;
  double* data_;
};

/// Each tail (a, r) of a point's records becomes (y, r).
inline void WhitenRows(const StripRecords& records, int64_t slot, int count,
                       const PointBlock* block) {
  for (int i = 0; i < count; ++i) {
    double* const tail = records.Tail(slot + i);
    for (double* at = tail; at < tail + kRecordTail; at += 4) {
      Quad y = {};
      if (block != nullptr) y = block->Whiten(LoadQuad(at));
      y[3] = at[3];
      StoreQuad(y, at);
    }
  }
}

/// Of a point's observations [begin, end), refined images' come first.
inline int CountRefined(const Terms& terms, int64_t begin, int64_t end) {
  while (end > begin && terms.image_refined[terms.plan->image.data()[end - 1]] == 0) --end;
  return static_cast<int>(end - begin);
}

/// block -= t_0 row_0^T + t_1 row_1^T, for records of each number of quads from 1 on.
using SubtractRows = void (*)(const double* t_0, const double* t_1, int num_rows,
                              const double* rows, double* block);

template <int kQuads>
void SubtractRowsOf(const double* t_0, const double* t_1, int num_rows, const double* rows,
                    double* block) {
  const RightFactor<kQuads> factor(rows);
  for (int i = 0; i < num_rows; ++i) {
    factor.template SubtractRow<0>(t_0[i], t_1[i], block + i * 4 * kQuads);
  }
}

inline constexpr SubtractRows kSubtractRows[] = {&SubtractRowsOf<1>, &SubtractRowsOf<2>,
                                                 &SubtractRowsOf<3>, &SubtractRowsOf<4>,
                                                 &SubtractRowsOf<5>, &SubtractRowsOf<6>};

/// Adds what points add, once their blocks are factorised. `kQuads`: of every image's rows, or of
/// the first image's where widths are mixed.
template <int kQuads, bool kMixed = false>
class Elimination {
 public:
  Elimination(const Terms& terms, const StripRecords& records, ChunkSum* sum)
      : terms_(terms),
        records_(records),
        sum_(*sum),
        num_columns_(kMixed ? terms.num_columns : kColumns),
        num_rows_(terms.num_rows),
        block_size_(static_cast<int64_t>(terms.num_rows) * num_columns_) {}

  /// The point's observations are [begin, end) of the plan and have records from `slot` on; rows
  /// [first_row, last_row) of its refined ones are wanted, all if last_row is 0. `block` is nullptr
  /// for a fixed point. Returns where the pairs of the next point begin.
  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    image_ = terms_.plan->image_in_chunk.data() + begin;
    WhitenRows(records_, slot, static_cast<int>(end - begin), block);
    const int refined = CountRefined(terms_, begin, end);
    for (int i = first_row; i < (last_row > 0 ? last_row : refined); ++i) {
      AddDiagonal(slot, i, block);
      if (block == nullptr) continue;
      for (int j = i + 1; j < refined; ++j) AddPair(slot, i, j, *pair_block++);
    }
    return pair_block;
  }

  /// Observation i of such a point alone, whose rows are white already, and its pairs.
  const uint16_t* AddRow(int64_t slot, int64_t begin, int refined, int i, const PointBlock* block,
                         const uint16_t* pair_block) {
    image_ = terms_.plan->image_in_chunk.data() + begin;
    const int32_t* const image = terms_.plan->image.data() + begin;
    num_rows_ = terms_.groups[terms_.image_group[image[i]]].num_columns;
    AddDiagonal(slot, i, block);
    for (int j = i + 1; j < refined && block != nullptr; ++j, ++pair_block) {
      const int width = terms_.groups[terms_.image_group[image[j]]].width;
      if (width == kColumns) {
        AddPair(slot, i, j, *pair_block);
      } else {
        AddPairOfWidths(slot, i, j, width, *pair_block);
      }
    }
    return pair_block;
  }

 private:
  static constexpr int kColumns = 4 * kQuads;

  const double* Tail(int64_t slot) const {
    return kMixed ? records_.Tail(slot) : records_.Of(slot) + 2 * kColumns;
  }
  double* Block(int block) const {
    return sum_.blocks + (kMixed ? sum_.block_begin[block] : block * block_size_);
  }

  void AddDiagonal(int64_t slot, int i, const PointBlock* block) {
    const double* const rows = records_.Of(slot + i);
    const double *y_0 = Tail(slot + i), *y_1 = y_0 + 4;
    const double r[2] = {y_0[3], y_1[3]};
    double reduced[2] = {r[0], r[1]};
    if (block != nullptr) {
      double h[4];
      StoreQuad(block->h, h);
      reduced[0] -= Dot3(y_0, h);
      reduced[1] -= Dot3(y_1, h);
    }
    UpdateVectors<kQuads>(
        rows, r, reduced,
        sum_.vectors + static_cast<int64_t>(image_[i]) * ChunkSum::kVectors * num_columns_);
    const double cross = Dot3(y_0, y_1);
    const double middle[4] = {Dot3(y_0, y_0) - 1, cross, cross, Dot3(y_1, y_1) - 1};
    Subtract(rows, middle, rows, true, Block(image_[i]));
    if (sum_.camera_diagonal == nullptr) return;
    constexpr double kMinusIdentity[4] = {-1, 0, 0, -1};
    Subtract(rows, kMinusIdentity, rows, true, sum_.camera_diagonal + image_[i] * block_size_);
  }

  void AddPair(int64_t slot, int i, int j, uint16_t block) {
    const double* const rows = records_.Of(slot + i);
    const double* const other = records_.Of(slot + j);
    double middle[4];
    MiddleOf(slot, i, j, middle);
    double* const target = Block(block);
    const bool same_image = image_[i] == image_[j];
    Subtract(rows, middle, other, same_image, target);
    if (!same_image) return;
    // An image that sees the point twice: its diagonal block has the pair in both orders.
    const double transposed[4] = {middle[0], middle[2], middle[1], middle[3]};
    Subtract(other, transposed, rows, true, target);
  }

  void AddPairOfWidths(int64_t slot, int i, int j, int width, uint16_t block) {
    double middle[4], t[2 * kColumns];
    MiddleOf(slot, i, j, middle);
    MiddleProduct<kQuads>(records_.Of(slot + i), middle, t);
    kSubtractRows[width / 4 - 1](t, t + kColumns, num_rows_, records_.Of(slot + j), Block(block));
  }

  /// Y_i Y_j^T
  void MiddleOf(int64_t slot, int i, int j, double middle[4]) const {
    const double *y_0 = Tail(slot + i), *y_1 = y_0 + 4;
    const double *z_0 = Tail(slot + j), *z_1 = z_0 + 4;
    middle[0] = Dot3(y_0, z_0), middle[1] = Dot3(y_0, z_1);
    middle[2] = Dot3(y_1, z_0), middle[3] = Dot3(y_1, z_1);
  }

  /// target -= left^T middle right, for the two rows of each.
  void Subtract(const double* left, const double middle[4], const double* right, bool upper,
                double* target) const {
    double t[2 * kColumns];
    MiddleProduct<kQuads>(left, middle, t);
    const RightFactor<kQuads> factor(right);
    if (upper) {
      factor.SubtractUpper(t, num_rows_, target);
    } else {
      factor.SubtractAll(t, num_rows_, target);
    }
  }

  const Terms& terms_;
  const StripRecords& records_;
  ChunkSum& sum_;
  const int num_columns_;  ///< of the widest record
  int num_rows_;           ///< of the first image's blocks
  const int64_t block_size_;
  const uint16_t* image_ = nullptr;
};

/// The same where widths are mixed: each observation's row by the width of its group.
class MixedElimination {
 public:
  MixedElimination(const Terms& terms, const StripRecords& records, ChunkSum* sum)
      : terms_(terms), records_(records), sum_(sum) {}

  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    WhitenRows(records_, slot, static_cast<int>(end - begin), block);
    const int refined = CountRefined(terms_, begin, end);
    const int32_t* const image = terms_.plan->image.data() + begin;
    for (int i = first_row; i < (last_row > 0 ? last_row : refined); ++i) {
      const int width = terms_.groups[terms_.image_group[image[i]]].width;
      pair_block = (this->*kAddRow[width / 4 - 1])(slot, begin, refined, i, block, pair_block);
    }
    return pair_block;
  }

 private:
  using AddRowFunction = const uint16_t* (MixedElimination::*)(int64_t, int64_t, int, int,
                                                               const PointBlock*, const uint16_t*);

  /// Flattened, as compilers give up inlining by the number of widths.
  template <int kQuads>
  __attribute__((flatten)) const uint16_t* AddRow(int64_t slot, int64_t begin, int refined, int i,
                                                  const PointBlock* block,
                                                  const uint16_t* pair_block) {
    return Elimination<kQuads, true>(terms_, records_, sum_)
        .AddRow(slot, begin, refined, i, block, pair_block);
  }

  static constexpr AddRowFunction kAddRow[] = {
      &MixedElimination::AddRow<1>, &MixedElimination::AddRow<2>, &MixedElimination::AddRow<3>,
      &MixedElimination::AddRow<4>, &MixedElimination::AddRow<5>, &MixedElimination::AddRow<6>};

  const Terms& terms_;
  const StripRecords& records_;
  ChunkSum* const sum_;
};

}  // namespace bundle::fused::BUNDLE_ISA
