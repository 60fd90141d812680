#pragma once

/// In which order the points are eliminated, and in which portions.
///
/// What one point adds to S are products of its observations' Jacobians, a block for every pair of
/// images that see it. Adding each to S where it lies costs more than computing it: the block comes
/// from far and goes back. So points are sorted by the images that see them, which puts points with
/// the same images next to each other, and taken in chunks. A chunk knows the image pairs that
/// occur in it and sums their blocks in a buffer, of which its points use one part after the other;
/// one addition a block and chunk then goes to S.
///
/// A chunk is a pure function of the state: its points in, its part of S, of the right side and of
/// the cost out. The sum over the chunks, in their order, is the whole, whoever computed them;
/// results therefore do not depend on the number of threads.
///
/// Memory: 20 bytes an observation (image and measurement, copied into this order, so that every
/// pass reads forwards), 2 bytes for its place in the chunk and 2 bytes for every pair of
/// observations of a point.

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

/// Points [first_point, last_point) of the plan. A point that so many images see that its blocks
/// alone are too many is spread over several chunks, each of which adds the rows of some images.
struct Chunk {
  int first_point = 0;
  int last_point = 0;
  /// Where it has one point: which of its observations' rows are added. All, where last_row is 0.
  int first_row = 0;
  int last_row = 0;
  int64_t first_pair = 0;  ///< in PointPlan::pair_block
  /// The images that occur, in the order of their blocks in the layout; block i of the chunk is the
  /// diagonal one of images[i].
  std::vector<int> images;
  /// Of each image, the last chunk before this one in which it occurs; -1: none.
  std::vector<int> previous_chunk;
  /// Blocks images.size() and up: pairs of indices into `images`, the first the smaller.
  struct Pair {
    uint16_t first, second;  ///< ascending by first, then second
  };
  std::vector<Pair> pairs;

  int num_blocks() const { return static_cast<int>(images.size() + pairs.size()); }
};

struct PointPlan {
  std::vector<int> point;      ///< index in the problem; free points, then fixed ones
  int num_free_points = 0;     ///< of those in `point`
  std::vector<int64_t> first;  ///< first observation of each point, and the end
  /// Of each observation; within a point in the order of the images' blocks in the layout, then
  /// images with nothing to refine.
  std::vector<int32_t> image;
  std::vector<double> xy;                ///< two of each observation
  std::vector<uint16_t> image_in_chunk;  ///< of each observation: index into Chunk::images
  /// Of each pair of observations i < j of a free point, i slowest, whose images have something to
  /// refine: the chunk's block.
  std::vector<uint16_t> pair_block;
  std::vector<Chunk> chunks;

  int num_points() const { return static_cast<int>(point.size()); }
  int64_t num_observations() const { return static_cast<int64_t>(image.size()); }
};

/// The most observations of a point. Its images and one row of its pairs have to have numbers of 16
/// bits, which would allow three times as many; but time and memory grow with its pairs: with
/// 10,000 observations, 50 million, 100 MB and a second or two a step.
inline constexpr int64_t kMaxTrackLength = 10000;

/// Bytes that the blocks of a chunk take, about, where they are many.
inline constexpr int64_t kMaxBufferBytes = 1 << 25;

/// The observations with something to refine. `block_bytes`: of one block's buffer.
PointPlan PlanPoints(const ProblemView& problem, const ParameterLayout& layout, int block_bytes,
                     int num_threads = 1);

/// The other observations, whose cost does not change.
PointPlan PlanFixedPoints(const ProblemView& problem, const ParameterLayout& layout,
                          int num_threads = 1);

}  // namespace bundle::fused
