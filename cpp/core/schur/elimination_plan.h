#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"
#include "core/scratch/large_vector.h"

namespace bundle {

class ImageParts;  // image_parts.h
class ThreadPool;

/// Plan of the elimination of the points: their order, and their division into chunks and tiles.
///
/// A point adds to S the products of its *entries*. An entry of a point is a part of the camera
/// parameters (image_parts.h) that its observations depend on, and the point adds a block for every
/// pair of entries. Adding each block directly to S costs more than computing it, because of cache
/// misses. So points are sorted by the images that see them, which makes points with the same
/// images neighbours, and divided into chunks. A chunk lists its pairs of parts and sums their
/// blocks in a buffer. Then each block is added once per chunk to S. If sums must have the same
/// bits on any number of ranks, points are sorted within their sections, and chunks end with
/// sections (sums/point_sections.h).
///
/// A chunk is processed tile by tile. The Jacobians of a tile's observations and the factors of its
/// entries fit the second-level cache. When they are known, the products are summed block by block:
/// a block stays in registers while all pairs of the tile are added to it
/// (kernels/tile_products.h). A tile lists its pairs by blocks, and its observations by images.
///
/// The result of a chunk depends only on the state: its contribution to S, to the right-hand side
/// and to the cost. Chunks are added in their order, independent of the thread that computed them.
/// So results do not depend on the number of threads.
///
/// Memory per observation: 20 bytes for image and measurement, copied into this order so that every
/// pass reads forwards; 8 more with sigmas; 4 bytes for its image in the chunk and its place in the
/// tile, and 2 for each kind of parts. Also 4 bytes for every pair of a point, and 4 for every
/// block of a tile.

/// Kinds of parts of the camera parameters (image_parts.h).
enum PartKind { kOwnPart, kCameraPart, kSensorPart };
inline constexpr int kMaxParts = 3;

/// Two entries of one point, by their numbers in the tile.
struct EntryPair {
  uint16_t first, second;
};

/// Points up to last_point, from the end of the tile before it.
struct Tile {
  /// A block of the chunk, and the number of the pairs that are added to it.
  struct Block {
    uint16_t block, num_pairs;
  };
  /// An image of the chunk, and the number of its observations.
  struct Image {
    uint16_t image, num_observations;
  };
  int last_point = 0;
  int last_block = 0;  ///< in Chunk::tile_blocks
  int last_image = 0;  ///< in Chunk::tile_images
};

/// Points [first_point, last_point) of the plan. A point whose blocks alone do not fit a chunk is
/// spread over several chunks. Each of these adds the rows of some of its entries.
struct Chunk {
  int first_point = 0;
  int last_point = 0;
  /// For a chunk of one point: the entries whose rows the chunk adds. All rows if last_row is 0.
  int first_row = 0;
  int last_row = 0;
  /// The parts that occur, ascending; block i of the chunk is the diagonal one of parts[i].
  std::vector<int> parts;
  int num_own_parts = 0;  ///< own parts come first
  /// Per own part: the previous chunk that has it; -1: no such chunk.
  std::vector<int> previous_chunk;
  /// Blocks from number parts.size() on: pairs of indices into `parts`, the smaller first.
  struct Pair {
    uint16_t first, second;  ///< ascending by first, then second
  };
  LargeVector<Pair> pairs;
  /// An image of the chunk: the index of each of its parts, and the block of each pair of them.
  struct Image {
    static constexpr uint16_t kNone = 0xffff;
    uint16_t part[kMaxParts] = {kNone, kNone, kNone};
    uint16_t cross[kMaxParts] = {kNone, kNone, kNone};  ///< CrossIndex
  };
  LargeVector<Image> images;
  std::vector<Tile> tiles;
  LargeVector<Tile::Block> tile_blocks;
  LargeVector<EntryPair> entry_pairs;
  LargeVector<Tile::Image> tile_images;
  /// Refined observations whose diagonal products the chunk adds, by their numbers in the tile.
  LargeVector<uint16_t> tile_observations;

  int num_blocks() const { return static_cast<int>(parts.size() + pairs.size()); }
};

/// Index of the block of two kinds in Chunk::Image::cross: own and camera, own and sensor, camera
/// and sensor.
inline constexpr int CrossIndex(int first, int second) { return first + second - 1; }

struct EliminationPlan {
  LargeVector<int> point;      ///< index in the problem; free points, then constant ones
  int num_free_points = 0;     ///< free points in `point`
  LargeVector<int64_t> first;  ///< first observation of each point, and the end
  /// Image per observation. The images of a point are in the order of their blocks in the layout,
  /// then images without free parameters.
  LargeVector<int32_t> image;
  LargeVector<double> xy;             ///< two numbers per observation
  LargeVector<double> inverse_sigma;  ///< one per observation; empty if the problem has no sigmas
  LargeVector<int32_t>
      observation;  ///< index of each observation in the problem; empty unless requested
  LargeVector<uint16_t> image_in_chunk;  ///< per observation: index into Chunk::images
  int num_kinds = 1;                     ///< ImageParts::num_kinds
  /// Per observation num_kinds numbers: the entry of its part in the tile, for free points. The
  /// first observation of an entry has the flag kFirstOfEntry.
  LargeVector<uint16_t> entry;
  static constexpr uint16_t kFirstOfEntry = 0x8000;
  int largest_tile_entries = 0;
  int largest_tile_points = 0;
  int64_t largest_tile_observations = 0;
  /// False for products with S that is not formed (implicit_product.cpp): chunks and tiles list
  /// only the pairs of an entry with itself, and of two parts of an image.
  bool has_pairs = true;
  std::vector<Chunk> chunks;
  /// First point of each section (point_sections.h), of free points, then of constant ones, and the
  /// end. Sections without points are left out. Without sections, all points are in one.
  std::vector<int> section_begin;

  int num_points() const { return static_cast<int>(point.size()); }
  int64_t num_observations() const { return static_cast<int64_t>(image.size()); }
};

/// The maximum number of observations of a point; kMaxParts times as many entries are below
/// kFirstOfEntry. Time and memory grow with its pairs: 10,000 observations have 50 million pairs,
/// 200 MB and a second or two per step.
inline constexpr int64_t kMaxTrackLength = 10000;

/// Approximate bytes of the blocks of a chunk, in large problems.
inline constexpr int64_t kMaxBufferBytes = 1 << 25;

/// Plan of the observations of images or points with free parameters. `keep_order`: fills
/// EliminationPlan::observation, for TakeMeasurements. `has_pairs`: EliminationPlan::has_pairs.
/// Either all ranks call this or none.
EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageParts& parts, ThreadPool* pool = nullptr,
                           bool keep_order = false, bool in_sections = false,
                           bool has_pairs = true);

/// Plan of the other observations, whose cost is constant.
EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const ImageParts& parts, ThreadPool* pool = nullptr,
                                bool keep_order = false);

/// Sizes that determine the cost of the passes over the points, computed without a pass.

struct PlanSize {
  int64_t num_points = 0;
  int64_t num_free_points = 0;
  int64_t num_observations = 0;
  int num_kinds = 1;            ///< ImageParts::num_kinds
  int64_t num_pairs = 0;        ///< pairs of entries of free points
  int64_t num_tile_blocks = 0;  ///< sum over the tiles: blocks that pairs are added to
  /// Sums over the chunks: pairs of parts that are added to S, and parts with their diagonal
  /// blocks.
  int64_t num_chunk_pairs = 0;
  int64_t num_chunk_parts = 0;
  int64_t largest_chunk_blocks = 0;
  int64_t block_doubles = 0;  ///< doubles of a block in a chunk's buffer
};

PlanSize MeasurePlan(const AdjustmentProblem& problem, const ParameterLayout& layout);

}  // namespace bundle
