#pragma once

/// Elimination of a chunk, tile by tile: linearise the observations of its strips, factorise their
/// points' blocks, compute the factors of their entries, then add the products of the tile.
/// Included by kernels.cpp only.

#include "core/schur/kernels/eliminate_point.h"
#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"
#include "core/schur/kernels/tile_products.h"

namespace bundle::BUNDLE_ISA {

/// Derivative w.r.t. the pose of the sensor: the one w.r.t. the pose of the frame times K.
inline void ChainSensor(const StateRecords& x, const Lanes& lanes, const int32_t* image,
                        const Pack* d_pose, Pack* d_sensor) {
  const double* records[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    records[lane] = x.images + int64_t{image[lanes.observation[lane]]} * x.stride + x.sensor_map;
  }
  Pack map[kPoseSize * kPoseSize];
  GatherRecords(records, kPoseSize * kPoseSize, map);
  for (int j = 0; j < kPoseSize; ++j) {
    d_sensor[j] = d_pose[0] * map[j];
    for (int i = 1; i < kPoseSize; ++i) d_sensor[j] += d_pose[i] * map[kPoseSize * i + j];
  }
}

/// Writes the records of observations in lanes and adds their costs to the lanes of `twice_cost`,
/// twice. With kAlong, the records have A d in place of the residual, for a step d of the camera
/// parameters.
template <bool kAlong>
inline void LinearizeLanes(const EliminationInput& input, const StateRecords& x, const Lanes& lanes,
                           const TileRecords& records, const StepRecords* step, Pack* twice_cost) {
  const LaneState state(input, x, lanes, true);
  LaneResiduals residuals(input, x, state, lanes, true);
  if constexpr (kAlong) residuals.Along(input, *step, lanes, state, residuals.r);
  double* out[kLanes];
  double discarded[2 * 4 * kMaxRecordQuads + kRecordHead];
  for (int lane = 0; lane < kLanes; ++lane) {
    out[lane] = lane < lanes.count ? records.Of(lanes.observation[lane]) : discarded;
  }
  const ModelGroup& group = *lanes.group;
  // By the numbers of ModelGroup::columns, after zeros for kNoColumn.
  Pack columns[1 + ModelGroup::kFirstOfSensor + kPoseSize];
  Pack* const derivative = columns + 1;
  static_assert(ModelGroup::kNoColumn == -1);
  columns[0] = 0.0;
  for (int row = 0; row < 2; ++row) {
    Pack d_point[3];
    residuals.ChainPose(state, row, derivative);
    residuals.ChainPoint(state, row, d_point);
    for (int k = 0; k < group.num_params; ++k) {
      derivative[kPoseSize + k] = residuals.d_params[row * group.num_params + k];
    }
    for (int k = 0; k < kTwistSize && group.rolls; ++k) {
      derivative[kFirstTwist + k] = residuals.d_twist[kTwistSize * row + k];
    }
    if (group.parts[kSensorPart].num_columns > 0) {
      ChainSensor(x, lanes, input.plan->image.data(), derivative,
                  derivative + ModelGroup::kFirstOfSensor);
    }
    const int width = 4 * group.num_quads;
    for (int j = 0; j < width; j += 4) {
      const Pack* quad[4];
      for (int k = 0; k < 4; ++k) quad[k] = derivative + group.columns[j + k];
      ScatterRecords(quad, out, kRecordHead + row * width + j);
    }
    const Pack* const head[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(head, out, 4 * row);
  }
  AddLanes(residuals.rho, lanes.count, twice_cost);
}

/// Linearises the strips of points [first_point, last_point) of a tile and calls visit(p, block of
/// the point) for each point. Adds their cost. kAlong, `step`: those of LinearizeLanes.
template <bool kAlong = false, typename Visit>
inline void VisitPoints(const EliminationInput& input, const StateRecords& x, int first_point,
                        int last_point, double damping, bool first, const double* squared_scale,
                        const TileRecords& records, double* total_cost, const Visit& visit,
                        const StepRecords* step = nullptr) {
  PointBlock blocks[kStripPoints];
  Pack twice_cost = 0.0;
  for (int point = first_point; point < last_point;) {
    const Strip strip(input, point, last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      LinearizeLanes<kAlong>(input, x, lanes, records, step, &twice_cost);
    });
    FormPointBlocks(input, strip, records.Of(strip.begin), records.stride(), damping, first,
                    squared_scale, blocks);
    for (int p = strip.first; p < strip.last; ++p) visit(p, blocks[p - strip.first]);
    point = strip.last;
  }
  *total_cost += 0.5 * SumOfLanes(twice_cost);
}

/// The tiles of a chunk, one after the other, with their lists.
struct TileCursor {
  const Chunk& chunk;
  int first_point = chunk.first_point;
  const EntryPair* pairs = chunk.entry_pairs.data();
  const Tile::Block* block = chunk.tile_blocks.data();
  const Tile::Image* image = chunk.tile_images.data();
  const uint16_t* observations = chunk.tile_observations.data();

  const Tile::Block* EndOfBlocks(const Tile& tile) const {
    return chunk.tile_blocks.data() + tile.last_block;
  }
  const Tile::Image* EndOfImages(const Tile& tile) const {
    return chunk.tile_images.data() + tile.last_image;
  }
  void Pass(const Tile& tile) {
    for (; block < EndOfBlocks(tile); ++block) pairs += block->num_pairs;
    for (; image < EndOfImages(tile); ++image) observations += image->num_observations;
    first_point = tile.last_point;
  }
};

template <int kOwn, int kCamera>
void EliminateChunk(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                    double damping, bool first, double* squared_scale, double* memory,
                    ChunkSum* sum) {
  const int64_t* const begin = input.plan->first.data();
  const bool counts = chunk.first_row == 0;
  double ignored = 0;
  TileCursor at = {chunk};
  for (const Tile* tile = chunk.tiles.data(); at.first_point < chunk.last_point; ++tile) {
    const TileRecords records(input, memory, at.first_point);
    VisitPoints(input, x, at.first_point, tile->last_point, damping, first, squared_scale, records,
                counts ? &sum->cost : &ignored, [&](int p, const PointBlock& block) {
                  for (int j = 0; j < 3 && first && counts; ++j) {
                    squared_scale[3 * p + j] = block.squared_scale[j];
                  }
                  const int num_refined = CountRefined(input, begin[p], begin[p + 1]);
                  if (p >= input.plan->num_free_points) {
                    for (int i = 0; i < num_refined && input.kept_records != nullptr; ++i) {
                      KeptRecords::Keep(input, begin[p] + i, records.Of(begin[p] + i),
                                        /*is_constant=*/true);
                    }
                    FinishConstantHeads(records, begin[p], num_refined);
                    return;
                  }
                  for (int j = 0; j < 3 && counts; ++j) {
                    const double g = block.Gradient(j), size = __builtin_fabs(g);
                    sum->gradient_squared += g * g;
                    if (!(size <= sum->gradient_max)) sum->gradient_max = size;
                  }
                  if (counts) sum->decrement += block.Decrement();
                  FormFactors<kOwn, kCamera, true>(input, chunk, records, begin[p], num_refined,
                                                   block, memory);
                });
    AddImages(input, chunk, at.image, at.EndOfImages(*tile), at.observations, begin[at.first_point],
              records, *sum);
    if (at.first_point < input.plan->num_free_points) {
      SubtractTile(input, chunk, at.block, at.EndOfBlocks(*tile), at.pairs, memory, *sum);
    }
    at.Pass(*tile);
  }
}

inline void Eliminate(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                      double damping, bool first, double* squared_scale, double* memory,
                      ChunkSum* sum) {
  using Function = decltype(Kernels::eliminate);
  static constexpr Function kAny = &EliminateChunk<0, 0>;
  static constexpr Function kFor[][3] = {
      {kAny, kAny, kAny},
      {&EliminateChunk<1, 0>, kAny, kAny},
      {&EliminateChunk<2, 0>, &EliminateChunk<2, 1>, &EliminateChunk<2, 2>},
      {&EliminateChunk<3, 0>, kAny, kAny},
      {&EliminateChunk<4, 0>, kAny, kAny},
      {&EliminateChunk<5, 0>, kAny, kAny},
      {&EliminateChunk<6, 0>, kAny, kAny},
      {kAny, kAny, kAny}};
  const Function eliminate =
      input.camera_quads < 3 ? kFor[input.own_quads][input.camera_quads] : kAny;
  eliminate(input, x, chunk, damping, first, squared_scale, memory, sum);
}

}  // namespace bundle::BUNDLE_ISA
