#pragma once

/// The elimination of a chunk; kernels_impl.h says how to include this.
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
#include "core/fused/eliminate/strip.h"

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

/// Writes the records of a batch and returns its cost.
inline double LinearizeBatch(const Terms& terms, const StateRecords& x, const Strip& strip,
                             const Batch& batch, const StripRecords& records) {
  const LaneState state(terms, x, batch, true);
  const LaneResiduals residuals(terms, x, state, batch, true);
  double* out[kLanes];
  double discarded[2 * kMaxColumns + kRecordTail];
  for (int lane = 0; lane < kLanes; ++lane) {
    out[lane] = lane < batch.count ? records.Of(batch.observation[lane] - strip.begin) : discarded;
  }
  const Pack zero = 0.0;
  const ModelGroup& group = *batch.group;
  for (int row = 0; row < 2; ++row) {
    Pack d_pose[kPoseSize], d_point[3];
    residuals.ChainPose(state, row, d_pose);
    residuals.ChainPoint(state, row, d_point);
    const Pack* const d_params = residuals.d_params + row * group.num_params;
    const int width = group.width;
    for (int j = 0; j < width; j += 4) {
      const Pack* quad[4];
      for (int k = 0; k < 4; ++k) {
        const int column = j + k < group.num_columns ? group.columns[j + k] : -1;
        quad[k] = column < 0           ? &zero
                  : column < kPoseSize ? d_pose + column
                                       : d_params + (column - kPoseSize);
      }
      ScatterRecords(quad, out, row * width + j);
    }
    const Pack* const tail[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(tail, out, 2 * terms.num_columns + 4 * row);
  }
  return 0.5 * Sum(residuals.rho, batch.count);
}

/// block -= t^T times the two rows of `right`, for one width of these.
using SubtractFunction = void (*)(const double* t, int width, const double* right, bool upper,
                                  int num_rows, double* block);

template <int kQuads>
inline void SubtractProduct(const double* t, int width, const double* right, bool upper,
                            int num_rows, double* block) {
  const RightFactor<kQuads> factor(right);
  if (upper) {
    factor.SubtractUpper(t, num_rows, block);
  } else {
    factor.SubtractAll(t, width, num_rows, block);
  }
}

/// Of each number of quads from 1 on.
inline constexpr SubtractFunction kSubtractProduct[] = {&SubtractProduct<1>, &SubtractProduct<2>,
                                                        &SubtractProduct<3>, &SubtractProduct<4>,
                                                        &SubtractProduct<5>, &SubtractProduct<6>};

/// Adds what points add, once their blocks are factorised. `kQuads`: of every image's rows; 0:
/// those of its group.
template <int kQuads>
class Elimination {
 public:
  Elimination(const Terms& terms, const StripRecords& records, ChunkSum* sum)
      : terms_(terms),
        records_(records),
        sum_(*sum),
        block_size_(static_cast<int64_t>(terms.num_rows) * terms.num_columns) {}

  /// The point's observations are [begin, end) of the plan and have records from `slot` on; rows
  /// [first_row, last_row) of its refined ones are wanted, all if last_row is 0. `block` is nullptr
  /// for a fixed point. Returns where the pairs of the next point begin.
  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    image_ = terms_.plan->image_in_chunk.data() + begin;
    world_image_ = terms_.plan->image.data() + begin;
    WhitenRows(slot, static_cast<int>(end - begin), block);
    while (end > begin && terms_.image_refined[terms_.plan->image.data()[end - 1]] == 0) --end;
    const auto refined = static_cast<int>(end - begin);
    for (int i = first_row; i < (last_row > 0 ? last_row : refined); ++i) {
      AddDiagonal(slot, i, block);
      if (block == nullptr) continue;
      for (int j = i + 1; j < refined; ++j) AddPair(slot, i, j, *pair_block++);
    }
    return pair_block;
  }

 private:
  static constexpr int kColumns = 4 * kQuads;

  const ModelGroup& GroupOf(int i) const {
    return terms_.groups[terms_.image_group[world_image_[i]]];
  }
  int WidthOf(int i) const {
    if constexpr (kQuads > 0) return kColumns;
    return GroupOf(i).width;
  }
  int RowsOf(int i) const {
    if constexpr (kQuads > 0) return terms_.num_rows;
    return GroupOf(i).num_columns;
  }
  double* Block(int block) const {
    if constexpr (kQuads > 0) return sum_.blocks + block * block_size_;
    return sum_.blocks + sum_.block_begin[block];
  }

  /// Each tail (a, r) of a record becomes (y, r).
  void WhitenRows(int64_t slot, int count, const PointBlock* block) const {
    for (int i = 0; i < count; ++i) {
      double* const tail = records_.Tail(slot + i);
      for (double* at = tail; at < tail + kRecordTail; at += 4) {
        Quad y = {};
        if (block != nullptr) y = block->Whiten(LoadQuad(at));
        y[3] = at[3];
        StoreQuad(y, at);
      }
    }
  }

  void AddDiagonal(int64_t slot, int i, const PointBlock* block) {
    const double* const rows = records_.Of(slot + i);
    const double *y_0 = records_.Tail(slot + i), *y_1 = y_0 + 4;
    const double r[2] = {y_0[3], y_1[3]};
    double reduced[2] = {r[0], r[1]};
    if (block != nullptr) {
      double h[4];
      StoreQuad(block->h, h);
      reduced[0] -= Dot3(y_0, h);
      reduced[1] -= Dot3(y_1, h);
    }
    UpdateVectors(
        rows, WidthOf(i), r, reduced,
        sum_.vectors + static_cast<int64_t>(image_[i]) * ChunkSum::kVectors * terms_.num_columns);
    const double cross = Dot3(y_0, y_1);
    const double middle[4] = {Dot3(y_0, y_0) - 1, cross, cross, Dot3(y_1, y_1) - 1};
    Subtract(i, rows, middle, i, rows, true, Block(image_[i]));
    if (sum_.camera_diagonal == nullptr) return;
    constexpr double kMinusIdentity[4] = {-1, 0, 0, -1};
    Subtract(i, rows, kMinusIdentity, i, rows, true,
             sum_.camera_diagonal +
                 image_[i] * static_cast<int64_t>(terms_.num_rows) * terms_.num_columns);
  }

  void AddPair(int64_t slot, int i, int j, uint16_t block) {
    const double* const rows = records_.Of(slot + i);
    const double* const other = records_.Of(slot + j);
    const double *y_0 = records_.Tail(slot + i), *y_1 = y_0 + 4;
    const double *z_0 = records_.Tail(slot + j), *z_1 = z_0 + 4;
    const double middle[4] = {Dot3(y_0, z_0), Dot3(y_0, z_1), Dot3(y_1, z_0), Dot3(y_1, z_1)};
    double* const target = Block(block);
    const bool same_image = image_[i] == image_[j];
    Subtract(i, rows, middle, j, other, same_image, target);
    if (!same_image) return;
    // An image that sees the point twice: its diagonal block has the pair in both orders.
    const double transposed[4] = {middle[0], middle[2], middle[1], middle[3]};
    Subtract(j, other, transposed, i, rows, true, target);
  }

  /// target -= left^T middle right, for the two rows of observations i and j of the point.
  void Subtract(int i, const double* left, const double middle[4], int j, const double* right,
                bool upper, double* target) const {
    const int width = WidthOf(i);
    if constexpr (kQuads > 0) {
      double t[2 * kColumns];
      MiddleProduct(left, width, middle, t);
      SubtractProduct<kQuads>(t, width, right, upper, terms_.num_rows, target);
    } else {
      double t[2 * kMaxColumns];
      MiddleProduct(left, width, middle, t);
      kSubtractProduct[WidthOf(j) / 4 - 1](t, width, right, upper, RowsOf(i), target);
    }
  }

  const Terms& terms_;
  const StripRecords& records_;
  ChunkSum& sum_;
  const int64_t block_size_;
  const uint16_t* image_ = nullptr;       ///< in the chunk, of the point's observations
  const int32_t* world_image_ = nullptr;  ///< in the problem
};

template <int kQuads>
void EliminateChunk(const Terms& terms, const StateRecords& x, const Chunk& chunk, double damping,
                    bool first, double* squared_scale, double* memory, ChunkSum* sum) {
  const StripRecords records(terms, memory);
  const int64_t* const begin = terms.plan->first.data();
  const uint16_t* pair_block = terms.plan->pair_block.data() + chunk.first_pair;
  Elimination<kQuads> elimination(terms, records, sum);
  const bool counts = chunk.first_row == 0;
  PointBlock blocks[kStripPoints];
  for (int point = chunk.first_point; point < chunk.last_point;) {
    const Strip strip(*terms.plan, point, chunk.last_point);
    double cost = 0;
    VisitBatches(terms, strip, [&](const Batch& batch) {
      cost += LinearizeBatch(terms, x, strip, batch, records);
    });
    FormPointBlocks(terms, strip, records.Tail(0), records.stride(), damping, first, squared_scale,
                    blocks);
    if (counts) sum->cost += cost;
    for (int p = strip.first; p < strip.last; ++p) {
      for (int j = 0; j < 3 && first && counts; ++j) {
        squared_scale[3 * p + j] = blocks[p - strip.first].squared_scale[j];
      }
      const PointBlock* block = nullptr;
      if (p < terms.plan->num_free_points) {
        block = blocks + (p - strip.first);
        for (int j = 0; j < 3 && counts; ++j) {
          const double g = block->Gradient(j), size = __builtin_fabs(g);
          sum->gradient_squared += g * g;
          if (!(size <= sum->gradient_max)) sum->gradient_max = size;
        }
      }
      pair_block = elimination.Add(begin[p] - strip.begin, begin[p], begin[p + 1], chunk.first_row,
                                   chunk.last_row, block, pair_block);
    }
    point = strip.last;
  }
}

using EliminateFunction = decltype(Kernels::eliminate);

inline EliminateFunction EliminateFor(int num_columns) {
  static constexpr EliminateFunction kFor[] = {&EliminateChunk<1>, &EliminateChunk<2>,
                                               &EliminateChunk<3>, &EliminateChunk<4>,
                                               &EliminateChunk<5>, &EliminateChunk<6>};
  return kFor[num_columns / 4 - 1];
}

inline void Eliminate(const Terms& terms, const StateRecords& x, const Chunk& chunk, double damping,
                      bool first, double* squared_scale, double* memory, ChunkSum* sum) {
  const EliminateFunction eliminate =
      terms.mixed ? &EliminateChunk<0> : EliminateFor(terms.num_columns);
  eliminate(terms, x, chunk, damping, first, squared_scale, memory, sum);
}

}  // namespace bundle::fused::BUNDLE_ISA
