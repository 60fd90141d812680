#pragma once

/// Elimination of a chunk, strip by strip: linearise its observations, factorise its points'
/// blocks, add each point's contribution. Included by kernels.cpp only.

#include "core/schur/kernels/eliminate_point.h"
#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"

namespace bundle::BUNDLE_ISA {

/// Writes the records of observations in lanes and returns their cost.
inline double LinearizeLanes(const EliminationInput& input, const StateRecords& x,
                             const Strip& strip, const Lanes& lanes, const StripRecords& records) {
  const LaneState state(input, x, lanes, true);
  const LaneResiduals residuals(input, x, state, lanes, true);
  double* out[kLanes];
  double discarded[2 * kMaxColumns + kRecordHead];
  for (int lane = 0; lane < kLanes; ++lane) {
    out[lane] = lane < lanes.count ? records.Of(lanes.observation[lane] - strip.begin) : discarded;
  }
  const Pack zero = 0.0;
  const ModelGroup& group = *lanes.group;
  for (int row = 0; row < 2; ++row) {
    Pack d_pose[kPoseSize], d_point[3];
    residuals.ChainPose(state, row, d_pose);
    residuals.ChainPoint(state, row, d_point);
    const Pack* const d_params = residuals.d_params + row * group.num_params;
    const int width = 4 * group.num_quads;
    for (int j = 0; j < width; j += 4) {
      const Pack* quad[4];
      for (int k = 0; k < 4; ++k) {
        const int column = j + k < group.num_columns ? group.columns[j + k] : -1;
        quad[k] = column < 0           ? &zero
                  : column < kPoseSize ? d_pose + column
                                       : d_params + (column - kPoseSize);
      }
      ScatterRecords(quad, out, kRecordHead + row * width + j);
    }
    const Pack* const head[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(head, out, 4 * row);
  }
  return 0.5 * Sum(residuals.rho, lanes.count);
}

template <typename Elimination>
void EliminateChunk(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                    double damping, bool first, double* squared_scale, double* memory,
                    ChunkSum* sum) {
  const StripRecords records(input, memory);
  const int64_t* const begin = input.plan->first.data();
  const uint16_t* pair_block = input.plan->pair_block.data() + chunk.first_pair;
  Elimination elimination(input, records, sum);
  const bool counts = chunk.first_row == 0;
  PointBlock blocks[kStripPoints];
  for (int point = chunk.first_point; point < chunk.last_point;) {
    const Strip strip(input, point, chunk.last_point);
    double cost = 0;
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      cost += LinearizeLanes(input, x, strip, lanes, records);
    });
    FormPointBlocks(input, strip, records.Of(0), records.stride(), damping, first, squared_scale,
                    blocks);
    if (counts) sum->cost += cost;
    for (int p = strip.first; p < strip.last; ++p) {
      for (int j = 0; j < 3 && first && counts; ++j) {
        squared_scale[3 * p + j] = blocks[p - strip.first].squared_scale[j];
      }
      const PointBlock* block = nullptr;
      if (p < input.plan->num_free_points) {
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
  static constexpr EliminateFunction kFor[] = {
      &EliminateChunk<Elimination<1>>, &EliminateChunk<Elimination<2>>,
      &EliminateChunk<Elimination<3>>, &EliminateChunk<Elimination<4>>,
      &EliminateChunk<Elimination<5>>, &EliminateChunk<Elimination<6>>};
  return kFor[num_columns / 4 - 1];
}

inline void Eliminate(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                      double damping, bool first, double* squared_scale, double* memory,
                      ChunkSum* sum) {
  const EliminateFunction eliminate =
      input.mixed ? &EliminateChunk<MixedElimination> : EliminateFor(input.num_columns);
  eliminate(input, x, chunk, damping, first, squared_scale, memory, sum);
}

}  // namespace bundle::BUNDLE_ISA
