#pragma once

/// Elimination of a point. Included by kernels.cpp only.
///
/// For a point with damped block V' = V + damping D^2 = L L^T and observations i, whose corrected
/// residuals and Jacobians are r_i, A_i (camera parameters, 2 x d) and B_i (point, 2x3), the Schur
/// complement of V' in the normal equations adds, with Y_i = B_i L^-T and h = L^-1 g,
///
///   S_ij += A_i^T (delta_ij I - B_i V'^-1 B_j^T) A_j = A_i^T (delta_ij I - Y_i Y_j^T) A_j,
///   b_i  -= A_i^T (r_i - B_i V'^-1 g)                = A_i^T (r_i - Y_i h).
///
/// Ceres' eliminator forms W_i = A_i^T B_i (d x 3) and the products W_i V'^-1 W_j^T, of rank 3.
/// With the 2x2 matrix in the middle, the products have rank 2 and the diagonal ones include A_i^T
/// A_i. Also, the subtraction is between numbers of the size of pixels, before they are multiplied.
/// For d = 9
///
///   an observation its projection and derivatives, about 400 flops, kLanes at a time;
///                     S_ii: 45 x 4 flops,
///   a pair            Y_i Y_j^T: 20, times A_i: 54, S_ij: 81 x 4 flops.
///
/// The records of a strip, 2 d + 8 doubles per observation, stay in the first-level cache.

#include "core/schur/kernels/point_block.h"

namespace bundle::BUNDLE_ISA {

inline constexpr int kMaxColumns = (kPoseSize + kMaxCameraParams + 3) / 4 * 4;
/// Number of doubles in a record before the two rows of the camera parameters: (a, r) of each row.
inline constexpr int kRecordHead = 8;

/// Records of a strip: [a_0 r_0 | a_1 r_1 | row 0 | row 1] per observation. The rows are as wide as
/// those of the image's group. All records have the length of the widest.
class StripRecords {
 public:
  StripRecords(const EliminationInput& input, double* memory)
      : stride_(kRecordHead + 2 * input.num_columns), data_(memory) {}

  int stride() const { return stride_; }
  double* Of(int64_t slot) const { return data_ + slot * stride_; }
  const double* Rows(int64_t slot) const { return Of(slot) + kRecordHead; }

 private:
  int stride_;
  double* data_;
};

/// Replaces the head (a, r) of each record of a point by (y, r).
inline void WhitenRows(const StripRecords& records, int64_t slot, int count,
                       const PointBlock* block) {
  for (int i = 0; i < count; ++i) {
    double* const head = records.Of(slot + i);
    for (double* at = head; at < head + kRecordHead; at += 4) {
      Quad y = {};
      if (block != nullptr) y = block->Whiten(LoadQuad(at));
      y[3] = at[3];
      StoreQuad(y, at);
    }
  }
}

/// Number of refined images among a point's observations [begin, end); these come first.
inline int CountRefined(const EliminationInput& input, int64_t begin, int64_t end) {
  while (end > begin && input.image_refined[input.plan->image.data()[end - 1]] == 0) --end;
  return static_cast<int>(end - begin);
}

/// block -= t_0 row_0^T + t_1 row_1^T, for `num_rows` entries of t = (t_0, t_1).
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

/// Functions by the number of quads of the rows minus one.
inline constexpr SubtractRows kSubtractRows[] = {&SubtractRowsOf<1>, &SubtractRowsOf<2>,
                                                 &SubtractRowsOf<3>, &SubtractRowsOf<4>,
                                                 &SubtractRowsOf<5>, &SubtractRowsOf<6>};

/// Adds the contributions of points whose blocks are factorised. `kQuads`: quads in the rows of
/// every image; with mixed widths, of the first image of each block.
template <int kQuads, bool kMixed = false>
class Elimination {
 public:
  Elimination(const EliminationInput& input, const StripRecords& records, ChunkSum* sum)
      : input_(input),
        records_(records),
        sum_(*sum),
        num_columns_(kMixed ? input.num_columns : kColumns),
        block_size_(static_cast<int64_t>(input.num_rows) * num_columns_) {}

  /// The point's observations are [begin, end) of the plan and have records from `slot` on. Adds
  /// rows [first_row, last_row) of its refined observations, all if last_row is 0. `block` is
  /// nullptr for a constant point. Returns the begin of the next point's pairs.
  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    WhitenRows(records_, slot, static_cast<int>(end - begin), block);
    const int refined = CountRefined(input_, begin, end);
    return AddRows<false>(slot, begin, refined, first_row, last_row > 0 ? last_row : refined, block,
                          pair_block);
  }

  /// Adds rows [first_row, last_row) of a point whose records are whitened and whose first
  /// `refined` observations are refined. `kPairsDiffer`: the second image of a pair may have
  /// another width.
  template <bool kPairsDiffer>
  const uint16_t* AddRows(int64_t slot, int64_t begin, int refined, int first_row, int last_row,
                          const PointBlock* block, const uint16_t* pair_block) {
    image_ = input_.plan->image_in_chunk.data() + begin;
    const int32_t* const image = input_.plan->image.data() + begin;
    for (int i = first_row; i < last_row; ++i) {
      const int num_rows = kMixed ? input_.image_columns[image[i]] : input_.num_rows;
      AddDiagonal(slot, i, num_rows, block);
      if (block == nullptr) continue;
      for (int j = i + 1; j < refined; ++j, ++pair_block) {
        const int quads = kPairsDiffer ? input_.image_quads[image[j]] : kQuads;
        if (quads == kQuads) {
          AddPair(slot, i, j, num_rows, *pair_block);
        } else {
          AddPairOfWidths(slot, i, j, num_rows, quads, *pair_block);
        }
      }
    }
    return pair_block;
  }

 private:
  static constexpr int kColumns = 4 * kQuads;

  double* Block(int block) const {
    return sum_.blocks + (kMixed ? sum_.block_begin[block] : block * block_size_);
  }

  void AddDiagonal(int64_t slot, int i, int num_rows, const PointBlock* block) {
    const double* const rows = records_.Rows(slot + i);
    const double *y_0 = records_.Of(slot + i), *y_1 = y_0 + 4;
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
    Subtract(rows, middle, rows, num_rows, true, Block(image_[i]));
    if (sum_.camera_diagonal == nullptr) return;
    if (input_.image_is_mapped != nullptr) {
      const EliminationPlan& plan = *input_.plan;
      const int image = plan.image.data()[image_ - plan.image_in_chunk.data() + i];
      if (input_.image_is_mapped[image] == 0) return;
      num_rows = kPoseSize;
    }
    constexpr double kMinusIdentity[4] = {-1, 0, 0, -1};
    Subtract(rows, kMinusIdentity, rows, num_rows, true,
             sum_.camera_diagonal + image_[i] * block_size_);
  }

  void AddPair(int64_t slot, int i, int j, int num_rows, uint16_t block) {
    const double* const rows = records_.Rows(slot + i);
    const double* const other = records_.Rows(slot + j);
    double middle[4];
    MiddleOf(slot, i, j, middle);
    double* const target = Block(block);
    const bool same_image = image_[i] == image_[j];
    Subtract(rows, middle, other, num_rows, same_image, target);
    if (!same_image) return;
    // An image that sees the point twice: the pair is added to its diagonal block in both orders.
    const double transposed[4] = {middle[0], middle[2], middle[1], middle[3]};
    Subtract(other, transposed, rows, num_rows, true, target);
  }

  /// Adds a pair whose second image has rows with another number of quads.
  void AddPairOfWidths(int64_t slot, int i, int j, int num_rows, int quads, uint16_t block) {
    double middle[4], t[2 * kColumns];
    MiddleOf(slot, i, j, middle);
    MiddleProduct<kQuads>(records_.Rows(slot + i), middle, t);
    kSubtractRows[quads - 1](t, t + kColumns, num_rows, records_.Rows(slot + j), Block(block));
  }

  /// Y_i Y_j^T
  void MiddleOf(int64_t slot, int i, int j, double middle[4]) const {
    const double *y_0 = records_.Of(slot + i), *y_1 = y_0 + 4;
    const double *z_0 = records_.Of(slot + j), *z_1 = z_0 + 4;
    middle[0] = Dot3(y_0, z_0), middle[1] = Dot3(y_0, z_1);
    middle[2] = Dot3(y_1, z_0), middle[3] = Dot3(y_1, z_1);
  }

  /// target -= left^T middle right, where left and right have two rows each.
  void Subtract(const double* left, const double middle[4], const double* right, int num_rows,
                bool upper, double* target) const {
    double t[2 * kColumns];
    MiddleProduct<kQuads>(left, middle, t);
    const RightFactor<kQuads> factor(right);
    if (upper) {
      factor.SubtractUpper(t, num_rows, target);
    } else {
      factor.SubtractAll(t, num_rows, target);
    }
  }

  const EliminationInput& input_;
  // Copies, because a store to a block could change the target of a reference.
  const StripRecords records_;
  const ChunkSum sum_;
  const int num_columns_;  ///< columns of the widest record
  const int64_t block_size_;
  const uint16_t* image_ = nullptr;
};

/// Variant for mixed widths. Few points have a rare width; all other points use the code for one
/// width.
class MixedElimination {
 public:
  MixedElimination(const EliminationInput& input, const StripRecords& records, ChunkSum* sum)
      : input_(input), records_(records), sum_(sum) {}

  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    WhitenRows(records_, slot, static_cast<int>(end - begin), block);
    const int refined = CountRefined(input_, begin, end);
    if (last_row == 0) last_row = refined;
    if (first_row == last_row) return pair_block;
    const int32_t* const image = input_.plan->image.data() + begin;
    const auto quads = [&](int i) { return input_.image_quads[image[i]]; };
    bool one_width = true;
    for (int i = first_row + 1; i < refined; ++i) one_width &= quads(i) == quads(first_row);
    if (one_width) {
      return (this->*kAddRows[quads(first_row) - 1])(slot, begin, refined, first_row, last_row,
                                                     block, pair_block);
    }
    for (int i = first_row; i < last_row; ++i) {
      pair_block =
          (this->*kAddRow[quads(i) - 1])(slot, begin, refined, i, i + 1, block, pair_block);
    }
    return pair_block;
  }

 private:
  using AddFunction = const uint16_t* (MixedElimination::*)(int64_t, int64_t, int, int, int,
                                                            const PointBlock*, const uint16_t*);

  /// Forced to flatten: with so many widths, compilers would stop inlining.
  template <int kQuads, bool kPairsDiffer>
  __attribute__((flatten)) const uint16_t* AddRows(int64_t slot, int64_t begin, int refined,
                                                   int first_row, int last_row,
                                                   const PointBlock* block,
                                                   const uint16_t* pair_block) {
    return Elimination<kQuads, true>(input_, records_, sum_)
        .template AddRows<kPairsDiffer>(slot, begin, refined, first_row, last_row, block,
                                        pair_block);
  }

  static constexpr AddFunction kAddRows[] = {
      &MixedElimination::AddRows<1, false>, &MixedElimination::AddRows<2, false>,
      &MixedElimination::AddRows<3, false>, &MixedElimination::AddRows<4, false>,
      &MixedElimination::AddRows<5, false>, &MixedElimination::AddRows<6, false>};
  static constexpr AddFunction kAddRow[] = {
      &MixedElimination::AddRows<1, true>, &MixedElimination::AddRows<2, true>,
      &MixedElimination::AddRows<3, true>, &MixedElimination::AddRows<4, true>,
      &MixedElimination::AddRows<5, true>, &MixedElimination::AddRows<6, true>};

  const EliminationInput& input_;
  const StripRecords& records_;
  ChunkSum* const sum_;
};

}  // namespace bundle::BUNDLE_ISA
