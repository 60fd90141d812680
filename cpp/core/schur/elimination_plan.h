#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Assigns numbers to the distinct pairs of 16-bit numbers in the order of their first appearance.
/// It is a hash table in one array, which grows with the pairs and is reused for the next chunk.
class PairNumbers {
 public:
  /// The number of a pair. A new pair gets `next`, the count of earlier pairs. The members of a
  /// pair are below 0xffff.
  uint16_t Find(uint16_t a, uint16_t b, size_t next) {
    if (2 * next >= slots_.size()) Grow();
    Slot& slot = SlotOf(static_cast<uint32_t>(a) << 16 | b);
    if (slot.pair == kNone) {
      slot.pair = static_cast<uint32_t>(a) << 16 | b;
      slot.number = static_cast<uint16_t>(next);
    }
    return slot.number;
  }

  void Clear() { slots_.assign(slots_.size(), Slot{}); }

 private:
  static constexpr uint32_t kNone = 0xffffffff;
  struct Slot {
    uint32_t pair = kNone;
    uint16_t number = 0;
  };

  /// Slot of a pair, or the empty slot where it would be inserted.
  Slot& SlotOf(uint32_t pair) {
    constexpr uint32_t kGoldenRatio = 0x9e3779b9;
    size_t at = pair * kGoldenRatio >> shift_;
    while (slots_[at].pair != kNone && slots_[at].pair != pair) at = (at + 1) & (slots_.size() - 1);
    return slots_[at];
  }

  void Grow() {
    const std::vector<Slot> before = std::move(slots_);
    --shift_;
    slots_.assign(size_t{1} << (32 - shift_), Slot{});
    for (const Slot& slot : before) {
      if (slot.pair != kNone) SlotOf(slot.pair) = slot;
    }
  }

  int shift_ = 22;
  std::vector<Slot> slots_ = std::vector<Slot>(1024);
};

/// Plan of the elimination of the points: their order, and their division into chunks.
///
/// A point adds to S the products of its observations' Jacobians, a block for every pair of images
/// that see it. Adding each block directly to S costs more than computing it, because of cache
/// misses. So points are sorted by the images that see them, which makes points with the same
/// images neighbours, and divided into chunks. A chunk lists its image pairs and sums their blocks
/// in a buffer. Then each block is added once per chunk to S. If sums must have the same bits on
/// any number of ranks, points are sorted within their sections, and chunks end with sections
/// (sums/point_sections.h).
///
/// A chunk is a pure function of the state. It maps its points to its contribution to S, to the
/// right-hand side and to the cost. Chunks are added in their order, independent of the thread that
/// computed them. So results do not depend on the number of threads.
///
/// Memory per observation: 20 bytes for image and measurement, copied into this order so that every
/// pass reads forwards; 8 more with sigmas; 2 bytes for its place in the chunk. Also 2 bytes for
/// every pair of observations of a point.

/// Points [first_point, last_point) of the plan. A point whose blocks alone do not fit a chunk is
/// spread over several chunks. Each of these adds the rows of some of its images.
struct Chunk {
  int first_point = 0;
  int last_point = 0;
  /// For a chunk of one point: the rows of its observations that the chunk adds. All rows if
  /// last_row is 0.
  int first_row = 0;
  int last_row = 0;
  int64_t first_pair = 0;  ///< in EliminationPlan::pair_block
  /// The images that occur, in the order of their blocks in the layout; block i of the chunk is the
  /// diagonal one of images[i].
  std::vector<int> images;
  /// Per image: the previous chunk with an image of the same owner; -1: no such chunk.
  std::vector<int> previous_chunk;
  /// Blocks from number images.size() on: pairs of indices into `images`, the smaller first.
  struct Pair {
    uint16_t first, second;  ///< ascending by first, then second
  };
  std::vector<Pair> pairs;

  int num_blocks() const { return static_cast<int>(images.size() + pairs.size()); }
};

struct EliminationPlan {
  std::vector<int> point;      ///< index in the problem; free points, then constant ones
  int num_free_points = 0;     ///< free points in `point`
  std::vector<int64_t> first;  ///< first observation of each point, and the end
  /// Image per observation. The images of a point are in the order of their blocks in the layout,
  /// then images without free parameters.
  std::vector<int32_t> image;
  std::vector<double> xy;             ///< two numbers per observation
  std::vector<double> inverse_sigma;  ///< one per observation; empty if the problem has no sigmas
  std::vector<int32_t>
      observation;  ///< index of each observation in the problem; empty unless requested
  std::vector<uint16_t> image_in_chunk;  ///< per observation: index into Chunk::images
  /// Block of the chunk for each pair of observations i < j of a free point, i slowest, if both
  /// images have free parameters.
  std::vector<uint16_t> pair_block;
  std::vector<Chunk> chunks;
  std::vector<int> image_owner;  ///< ImageOrder::owner
  /// First point of each section (point_sections.h), of free points, then of constant ones, and the
  /// end. Sections without points are left out. Without sections, all points are in one.
  std::vector<int> section_begin;

  int num_points() const { return static_cast<int>(point.size()); }
  int64_t num_observations() const { return static_cast<int64_t>(image.size()); }
};

/// The maximum number of observations of a point. The 16-bit numbers of a chunk would allow three
/// times as many. But time and memory grow with its pairs: 10,000 observations have 50 million
/// pairs, 100 MB and a second or two per step.
inline constexpr int64_t kMaxTrackLength = 10000;

/// Approximate bytes of the blocks of a chunk, in large problems.
inline constexpr int64_t kMaxBufferBytes = 1 << 25;

/// Plan of the observations of images or points with free parameters. `block_bytes`: size of one
/// block's buffer. `keep_order`: fills EliminationPlan::observation, for TakeMeasurements. Either
/// all ranks call this or none.
EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           int block_bytes, int num_threads = 1, bool keep_order = false,
                           bool in_sections = false);

/// Plan of the other observations, whose cost is constant.
EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                int num_threads = 1, bool keep_order = false);

/// Copies the changed measurements of the problem into a plan that kept its order.
void TakeMeasurements(const AdjustmentProblem& problem, EliminationPlan* plan);

/// Sizes that determine the cost of the passes over the points, computed without a pass.

struct PlanSize {
  int64_t num_points = 0;
  int64_t num_free_points = 0;
  int64_t num_observations = 0;
  /// Pairs of observations of a free point, if both images have free parameters.
  int64_t num_pairs = 0;
  /// Sums over the chunks: pairs of images that are added to S, and images with their diagonal
  /// blocks.
  int64_t num_chunk_pairs = 0;
  int64_t num_chunk_images = 0;
  int64_t largest_chunk_blocks = 0;
  int64_t block_doubles = 0;  ///< doubles of a block in a chunk's buffer
};

PlanSize MeasurePlan(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// The observations of a plan that hold a residual at a state (factors/reprojection.h). Memory: 24
/// bytes for each of these observations, and none for the others.

}  // namespace bundle
