#pragma once

/// The passes of kernels.h, for one instruction set. Compiled by kernels_*.cpp, each of which
/// defines BUNDLE_ISA, the name of the namespace, and BUNDLE_LANES, the doubles of a register.
///
/// Elimination. Of a point with damped block V' = V + damping D^2 = L L^T and observations i, whose
/// corrected residuals and Jacobians are r_i, A_i (camera side, 2 x d) and B_i (point, 2x3), the
/// Schur complement of V' in the normal equations adds, with Y_i = B_i L^-T and h = L^-1 g,
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
/// Nothing of the size of the Jacobian is kept: a strip's records (2 d + 8 doubles an observation)
/// live in the first-level cache. Each observation is read once a pass: 20 bytes of image and
/// measurement, 2 of its place in the chunk, 2 a pair; a point is 24 bytes of coordinates and 24 of
/// scaling.
///
/// Back-substitution. Given the step d of the cameras, u_i = A_i d needs no A_i but a directional
/// derivative, and
///
///   dX = -V'^-1 (g + sum of B_i^T u_i).
///
/// Keeping V'^-1, g and B_i from the elimination would cost 64 bytes an observation and more to
/// write and read than the recomputation costs, which on the way also evaluates the candidate.

#include "core/fused/eliminate/point_block.h"
#include "core/fused/eliminate/strip.h"

namespace bundle::fused::BUNDLE_ISA {

// ---- Elimination

inline constexpr int kMaxColumns = (kPoseSize + kMaxCameraParams + 3) / 4 * 4;
/// Doubles of a record beyond two rows of the camera side: (a, r) of each row.
inline constexpr int kRecordTail = 8;

/// Records of a strip: [row 0 | row 1 | a_0 r_0 | a_1 r_1] an observation.
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
  const LaneResiduals residuals(terms, state, batch, true);
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
    for (int j = 0; j < terms.num_columns; j += 4) {
      const Pack* quad[4];
      for (int k = 0; k < 4; ++k) {
        const int column = j + k < group.num_columns ? group.columns[j + k] : -1;
        quad[k] = column < 0           ? &zero
                  : column < kPoseSize ? d_pose + column
                                       : d_params + (column - kPoseSize);
      }
      ScatterRecords(quad, out, row * terms.num_columns + j);
    }
    const Pack* const tail[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(tail, out, 2 * terms.num_columns + 4 * row);
  }
  return 0.5 * Sum(residuals.rho, batch.count);
}

/// The two rows of a record in registers, to be multiplied from the left.
template <int kQuads>
struct RightFactor {
  Quad row_0[kQuads], row_1[kQuads];

  explicit RightFactor(const double* rows) {
    for (int q = 0; q < kQuads; ++q) {
      row_0[q] = LoadQuad(rows + 4 * q);
      row_1[q] = LoadQuad(rows + 4 * (kQuads + q));
    }
  }

  /// block row -= t_0 row_0 + t_1 row_1, from quad kFirst on.
  template <int kFirst>
  void SubtractRow(double t_0, double t_1, double* block_row) const {
#pragma GCC unroll 8
    for (int q = kFirst; q < kQuads; ++q) {
      double* const at = block_row + 4 * q;
      StoreQuad(LoadQuad(at) - t_0 * row_0[q] - t_1 * row_1[q], at);
    }
  }

  /// block -= t_0 row_0^T + t_1 row_1^T, for `num_rows` entries of t = (t_0, t_1).
  void SubtractAll(const double* t, int num_rows, double* block) const {
    for (int i = 0; i < num_rows; ++i) {
      SubtractRow<0>(t[i], t[4 * kQuads + i], block + i * 4 * kQuads);
    }
  }

  /// The same from the diagonal on, rounded down to whole quads.
  template <int kFirst = 0>
  void SubtractUpper(const double* t, int num_rows, double* block) const {
    if constexpr (kFirst < kQuads) {
      for (int i = 4 * kFirst; i < num_rows && i < 4 * kFirst + 4; ++i) {
        SubtractRow<kFirst>(t[i], t[4 * kQuads + i], block + i * 4 * kQuads);
      }
      SubtractUpper<kFirst + 1>(t, num_rows, block);
    }
  }
};

/// t = (row_0 m[0][0] + row_1 m[1][0], row_0 m[0][1] + row_1 m[1][1])
template <int kQuads>
inline void MiddleProduct(const double* rows, const double m[4], double* t) {
  constexpr int kColumns = 4 * kQuads;
  for (int q = 0; q < kQuads; ++q) {
    const Quad row_0 = LoadQuad(rows + 4 * q), row_1 = LoadQuad(rows + kColumns + 4 * q);
    StoreQuad(row_0 * m[0] + row_1 * m[2], t + 4 * q);
    StoreQuad(row_0 * m[1] + row_1 * m[3], t + kColumns + 4 * q);
  }
}

/// What one observation adds to the vectors of its image: J_c^T r, J_c^T (r - Y h), ||J e_j||^2.
template <int kQuads>
inline void UpdateVectors(const double* rows, const double r[2], const double reduced[2],
                          double* vectors) {
  constexpr int kColumns = 4 * kQuads;
  for (int q = 0; q < kQuads; ++q) {
    const Quad row_0 = LoadQuad(rows + 4 * q), row_1 = LoadQuad(rows + kColumns + 4 * q);
    double* at = vectors + 4 * q;
    StoreQuad(LoadQuad(at) + row_0 * r[0] + row_1 * r[1], at);
    at += kColumns;
    StoreQuad(LoadQuad(at) + row_0 * reduced[0] + row_1 * reduced[1], at);
    at += kColumns;
    StoreQuad(LoadQuad(at) + row_0 * row_0 + row_1 * row_1, at);
  }
}

inline double Dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/// Adds what points add, once their blocks are factorised.
template <int kQuads>
class Elimination {
 public:
  Elimination(const Terms& terms, const StripRecords& records, ChunkSum* sum)
      : terms_(terms),
        records_(records),
        sum_(*sum),
        block_size_(static_cast<int64_t>(terms.num_rows) * kColumns) {}

  /// The point's observations are [begin, end) of the plan and have records from `slot` on; rows
  /// [first_row, last_row) of its refined ones are wanted, all if last_row is 0. `block` is nullptr
  /// for a fixed point. Returns where the pairs of the next point begin.
  const uint16_t* Add(int64_t slot, int64_t begin, int64_t end, int first_row, int last_row,
                      const PointBlock* block, const uint16_t* pair_block) {
    image_ = terms_.plan->image_in_chunk.data() + begin;
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
    const double *y_0 = rows + 2 * kColumns, *y_1 = y_0 + 4;
    const double r[2] = {y_0[3], y_1[3]};
    double reduced[2] = {r[0], r[1]};
    if (block != nullptr) {
      double h[4];
      StoreQuad(block->h, h);
      reduced[0] -= Dot3(y_0, h);
      reduced[1] -= Dot3(y_1, h);
    }
    UpdateVectors<kQuads>(rows, r, reduced,
                          sum_.vectors + static_cast<int64_t>(image_[i]) * 4 * kColumns);
    const double cross = Dot3(y_0, y_1);
    const double middle[4] = {Dot3(y_0, y_0) - 1, cross, cross, Dot3(y_1, y_1) - 1};
    Subtract(rows, middle, rows, true, sum_.blocks + image_[i] * block_size_);
    if (sum_.camera_diagonal == nullptr) return;
    constexpr double kMinusIdentity[4] = {-1, 0, 0, -1};
    Subtract(rows, kMinusIdentity, rows, true, sum_.camera_diagonal + image_[i] * block_size_);
  }

  void AddPair(int64_t slot, int i, int j, uint16_t block) {
    const double* const rows = records_.Of(slot + i);
    const double* const other = records_.Of(slot + j);
    const double *y_0 = rows + 2 * kColumns, *y_1 = y_0 + 4;
    const double *z_0 = other + 2 * kColumns, *z_1 = z_0 + 4;
    const double middle[4] = {Dot3(y_0, z_0), Dot3(y_0, z_1), Dot3(y_1, z_0), Dot3(y_1, z_1)};
    double* const target = sum_.blocks + block * block_size_;
    const bool same_image = image_[i] == image_[j];
    Subtract(rows, middle, other, same_image, target);
    if (!same_image) return;
    // An image that sees the point twice: its diagonal block has the pair in both orders.
    const double transposed[4] = {middle[0], middle[2], middle[1], middle[3]};
    Subtract(other, transposed, rows, true, target);
  }

  /// target -= left^T middle right, for the two rows of each.
  void Subtract(const double* left, const double middle[4], const double* right, bool upper,
                double* target) const {
    double t[2 * kColumns];
    MiddleProduct<kQuads>(left, middle, t);
    const RightFactor<kQuads> factor(right);
    if (upper) {
      factor.SubtractUpper(t, terms_.num_rows, target);
    } else {
      factor.SubtractAll(t, terms_.num_rows, target);
    }
  }

  const Terms& terms_;
  const StripRecords& records_;
  ChunkSum& sum_;
  const int64_t block_size_;
  const uint16_t* image_ = nullptr;
};

/// Sums up the blocks of a strip's points and factorises them. `rows` points at (a_0, r_0, a_1,
/// r_1) of the strip's first observation; the next one's are `stride` doubles on.
inline void FormPointBlocks(const Terms& terms, const Strip& strip, const double* rows, int stride,
                            double damping, bool first, const double* squared_scale,
                            PointBlock* blocks) {
  const int64_t* const begin = terms.plan->first.data();
  for (int p = strip.first; p < strip.last; ++p) {
    PointBlock& block = blocks[p - strip.first];
    for (Quad& row : block.sum) row = Quad{};
    for (int64_t i = begin[p]; i < begin[p + 1]; ++i) {
      const double* const at = rows + (i - strip.begin) * stride;
      block.Add(LoadQuad(at));
      block.Add(LoadQuad(at + 4));
    }
    for (int j = 0; j < 3; ++j) block.squared_scale[j] = first ? 0 : squared_scale[3 * p + j];
    block.squared_scale[3] = 0;
  }
  Factorize(blocks, strip.num_points(), damping, first);
}

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
  EliminateFor(terms.num_columns)(terms, x, chunk, damping, first, squared_scale, memory, sum);
}

// ---- Back-substitution and candidates

/// Records of a strip: [a_0 r_0 | a_1 r_1 | u_0 u_1 v_0 v_1] an observation, u = A d for one
/// direction d of the cameras, v for another where there is one.
inline constexpr int kStepRecord = 12;

inline void LinearizeAlong(const Terms& terms, const StateRecords& x, const Strip& strip,
                           const Batch& batch, const StepRecords& step, const StepRecords* other,
                           double* records) {
  const LaneState state(terms, x, batch, true);
  const LaneResiduals residuals(terms, state, batch, true);
  double* out[kLanes];
  double discarded[kStepRecord];
  for (int lane = 0; lane < kLanes; ++lane) {
    const int64_t slot = batch.observation[lane] - strip.begin;
    out[lane] = lane < batch.count ? records + slot * kStepRecord : discarded;
  }
  Pack along[4] = {0.0, 0.0, 0.0, 0.0};
  residuals.Along(terms, step, batch, state, along);
  if (other != nullptr) residuals.Along(terms, *other, batch, state, along + 2);
  for (int row = 0; row < 2; ++row) {
    Pack d_point[3];
    residuals.ChainPoint(state, row, d_point);
    const Pack* const tail[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(tail, out, 4 * row);
  }
  const Pack* const last[4] = {along, along + 1, along + 2, along + 3};
  ScatterRecords(last, out, 8);
}

/// dX = -V'^-1 (g + sum of B^T u), u being entries `entry` and `entry` + 1 of the point's records.
inline void BackSubstitute(const PointBlock& block, const double* records, int64_t count, int entry,
                           double* step) {
  Quad sum = {block.Gradient(0), block.Gradient(1), block.Gradient(2), 0};
  for (const double* at = records; at < records + count * kStepRecord; at += kStepRecord) {
    sum += LoadQuad(at) * at[entry] + LoadQuad(at + 4) * at[entry + 1];
  }
  SolveTransposed(block, -block.Whiten(sum), step);
}

inline double CandidateCost(const Terms& terms, const StateRecords& x, const Strip& strip) {
  double cost = 0;
  VisitBatches(terms, strip, [&](const Batch& batch) {
    const LaneState state(terms, x, batch, false);
    cost += Sum(LaneResiduals(terms, state, batch, false).rho, batch.count);
  });
  return 0.5 * cost;
}

inline void TryNewton(const Terms& terms, const StateRecords& x, const Chunk& chunk, double damping,
                      const double* squared_scale, const StepRecords& step,
                      const StateRecords& candidate, double* candidate_points, double* memory,
                      CandidateSum* sum) {
  const int64_t* const begin = terms.plan->first.data();
  PointBlock blocks[kStripPoints];
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(*terms.plan, point, chunk.last_point);
    VisitBatches(terms, strip, [&](const Batch& batch) {
      LinearizeAlong(terms, x, strip, batch, step, nullptr, memory);
    });
    FormPointBlocks(terms, strip, memory, kStepRecord, damping, false, squared_scale, blocks);
    for (int p = strip.first; p < strip.last; ++p) {
      const int64_t count = begin[p + 1] - begin[p];
      const double* const records = memory + (begin[p] - strip.begin) * kStepRecord;
      double d[3] = {};
      if (p < terms.plan->num_free_points) {
        BackSubstitute(blocks[p - strip.first], records, count, 8, d);
      }
      for (int j = 0; j < 3; ++j) {
        const double moved = x.points[3 * p + j] + d[j];
        candidate_points[3 * p + j] = moved;
        if (p >= terms.plan->num_free_points) continue;
        sum->step_squared += d[j] * d[j];
        sum->state_squared += moved * moved;
      }
      for (const double* at = records; at < records + count * kStepRecord; at += kStepRecord) {
        for (int row = 0; row < 2; ++row) {
          const double model = at[8 + row] + Dot3(at + 4 * row, d);
          sum->model_cost_change -= model * (at[4 * row + 3] + 0.5 * model);
        }
      }
    }
    sum->cost += CandidateCost(terms, candidate, strip);
    point = strip.last;
  }
}

inline void AddProducts(const double* record, const double* p, const double* q, ProductSum* sum) {
  for (int row = 0; row < 2; ++row) {
    const double* const a = record + 4 * row;
    const double along_p = record[8 + row] + Dot3(a, p), along_q = record[10 + row] + Dot3(a, q);
    sum->j_pp += along_p * along_p;
    sum->j_pq += along_p * along_q;
    sum->j_qq += along_q * along_q;
  }
}

inline void Products(const Terms& terms, const StateRecords& x, const Chunk& chunk, double damping,
                     const double* squared_scale, const StepRecords& camera_p,
                     const StepRecords& camera_q, double* points_p, double* points_q,
                     double* memory, ProductSum* sum) {
  const int64_t* const begin = terms.plan->first.data();
  PointBlock blocks[kStripPoints];
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(*terms.plan, point, chunk.last_point);
    VisitBatches(terms, strip, [&](const Batch& batch) {
      LinearizeAlong(terms, x, strip, batch, camera_p, &camera_q, memory);
    });
    FormPointBlocks(terms, strip, memory, kStepRecord, damping, false, squared_scale, blocks);
    for (int i = strip.first; i < strip.last; ++i) {
      const int64_t count = begin[i + 1] - begin[i];
      const double* const records = memory + (begin[i] - strip.begin) * kStepRecord;
      const PointBlock& block = blocks[i - strip.first];
      double *p = points_p + 3 * i, *q = points_q + 3 * i;
      for (int j = 0; j < 3; ++j) p[j] = q[j] = 0;
      if (i < terms.plan->num_free_points) {
        BackSubstitute(block, records, count, 10, q);
        for (int j = 0; j < 3; ++j) {
          const double d_squared = block.d_squared[j];
          p[j] = block.Gradient(j) / d_squared;
          sum->d_pp += p[j] * d_squared * p[j];
          sum->d_pq += p[j] * d_squared * q[j];
          sum->d_qq += q[j] * d_squared * q[j];
        }
      }
      for (int64_t k = 0; k < count; ++k) AddProducts(records + k * kStepRecord, p, q, sum);
    }
    point = strip.last;
  }
}

inline double Cost(const Terms& terms, const StateRecords& x, const Chunk& chunk) {
  double cost = 0;
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(*terms.plan, point, chunk.last_point);
    cost += CandidateCost(terms, x, strip);
    point = strip.last;
  }
  return cost;
}

inline int64_t MemoryDoubles(const Terms& terms) {
  const int record = 2 * terms.num_columns + kRecordTail;
  return (kStripObservations + terms.longest_track) *
         static_cast<int64_t>(record > kStepRecord ? record : kStepRecord);
}

constexpr Kernels MakeKernels(const char* name) {
  return {name, &MemoryDoubles, &Eliminate, &TryNewton, &Products, &Cost};
}

}  // namespace bundle::fused::BUNDLE_ISA
