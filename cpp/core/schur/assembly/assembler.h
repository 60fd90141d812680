#pragma once

/// Assembly of S: adds a chunk's blocks of image pairs to blocks of the parameter layout.
///
/// The passes work by image, with the columns that any image of its camera model refines: its pose,
/// then its intrinsics. In the layout, the columns of an image are one block. They are two blocks
/// if it shares intrinsics with other images. Some columns may be constant. A block of images (a,
/// b) is thus added to up to four blocks of S. If both have the same intrinsics block, it and its
/// transpose are added to the diagonal block.
///
/// An image of a rig has the columns of its frame's pose and shares this block with the other
/// images of the frame. A refined sensor is a third block, through a map (column_map.h).
///
/// Several threads add chunks at the same time, but no bit may depend on their speed. So each block
/// of S belongs to one queue, and chunks are added to a queue in their order. The blocks of a pose
/// belong to the queue of its image or frame (ImageOrder::owner). The block of two poses belongs to
/// the queue of the first. All blocks between shared cameras or sensors belong to one queue. Only
/// this queue is serial. It is short: 9 of the 81 products of a pair if a camera has three
/// parameters.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/linear/block_structure.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/column_map.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

/// The camera parameters' part of the normal equations.
struct CameraSums {
  BlockSystem system;
  std::vector<double> gradient;       ///< J_c^T r
  std::vector<double> squared_norms;  ///< ||J e_j||^2

  /// Error terms of the sums while chunks are added (double_double.h). Those of S are stored block
  /// by block, each column-major, because in S itself the columns of a block are far apart.
  struct ErrorTerms {
    std::vector<double> values, rhs, camera_diagonal, gradient, squared_norms;
  };
  bool has_error_terms = false;
  ErrorTerms error_terms;

  double* ErrorTermsOf(std::vector<double>* of) const {
    return has_error_terms ? of->data() : nullptr;
  }
};

class Assembler {
 public:
  /// `groups` and `image_group` as in EliminationInput.
  Assembler(const AdjustmentProblem& problem, const ParameterLayout& layout,
            const std::vector<ModelGroup>& groups, const std::vector<uint8_t>& image_group,
            const BlockStructure& structure);
  Assembler(const Assembler&) = delete;
  Assembler& operator=(const Assembler&) = delete;

  /// Lays out the error terms of S. Call before any error term is stored.
  void PlaceErrorTerms() { compact_ = CompactStructure(structure_); }

  /// Sets the maps at a state, before its chunks are added.
  void SetMaps(const CameraStates& cameras);
  /// True if there are maps. Chunks then need the camera_diagonal of the images that have maps.
  bool has_maps() const { return !maps_.empty(); }
  /// Per image: 1 if it has a map, if only poses have maps. nullptr: other blocks also have maps,
  /// which need all of the camera_diagonal.
  const uint8_t* image_is_mapped() const {
    return image_is_mapped_.empty() ? nullptr : image_is_mapped_.data();
  }

  /// The pairs of a chunk that contain one of its images, ascending.
  struct PairsOfImage {
    size_t first = 0, last = 0;  ///< [first, last): pairs with this image as first image
    const int* as_second = nullptr;
    size_t num_as_second = 0;
  };

  /// Adds the sums of a chunk for its image i: its vectors, its diagonal block and its pairs. Rows
  /// and columns between shared blocks are left out.
  void AddImage(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum, size_t i,
                const PairsOfImage& pairs, CameraSums* sums) const;

  /// Adds the sums of a chunk between shared blocks, after AddImage. Does nothing without shared
  /// blocks.
  void AddSharedBlocks(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum,
                       CameraSums* sums) const;

  /// Adds the error terms to the sums, after the last chunk. The sums are doubles afterwards.
  void Round(ThreadPool* pool, CameraSums* sums) const;

  /// S += damping D^2, and the same for the block diagonal, whose upper triangles it completes.
  void AddDamping(double damping, const std::vector<double>& d_squared, CameraSums* sums) const;

  /// Sets the rows and columns of the marked Jacobian columns in the sums to zero.
  void ClearColumns(const std::vector<uint8_t>& which, CameraSums* sums) const;

  /// The first entry of CameraSums::ErrorTerms::values for a block column, and their number.
  int64_t error_terms_begin(int block_column) const { return compact_.panel_begin[block_column]; }
  int64_t num_error_terms() const { return compact_.num_values; }

  /// True if the layout has blocks that images of several poses share.
  bool has_shared_blocks() const { return has_shared_blocks_; }

  /// The blocks that an image's columns are added to: their number, at most four, and the first.
  int num_blocks(int image) const { return images_[image].count; }
  const ImageBlock* blocks_of(int image) const { return images_[image].of; }

  /// Begin of block j of the layout in BlockSystem::camera_diagonal.
  const std::vector<int64_t>& diagonal_begin() const { return diagonal_begin_; }

 private:
  struct ImageBlocks {
    ImageBlock of[4];
    int count = 0;
    int num_columns = 0;  ///< number of local columns
  };

  /// Segments of an image's columns to which a sum is added.
  enum class Part { kOwn, kShared };
  /// Blocks of a pair to which a sum is added: those of the first image's pose; those of the second
  /// image's pose with shared blocks of the first; or those between shared blocks of both.
  enum class PairPart { kFirst, kSecond, kShared };

  /// Consecutive sums and their error terms; nullptr: without error terms.
  struct Target {
    double* sum = nullptr;
    double* error = nullptr;
    void Add(int64_t i, double value) const;
  };

  void AddBlock(int image, int place, const ModelGroup& group);
  /// `squares`: A^T A of the image; only blocks with a map (ImageBlock::map) use it.
  void AddVectors(const EliminationInput& input, int image, const double* vectors,
                  const double* squares, Part part, CameraSums* sums) const;
  void AddDiagonal(const EliminationInput& input, int image, const double* block, Part part,
                   CameraSums* sums) const;
  void AddCameraDiagonal(const EliminationInput& input, int image, const double* block, Part part,
                         CameraSums* sums) const;
  void AddPair(const EliminationInput& input, int first, int second, const double* block,
               PairPart part, CameraSums* sums) const;
  void AddPairOf(const ImageBlock& a, const ImageBlock& b, const double* block, int width,
                 CameraSums* sums) const;
  static void AddColumn(const ImageBlock& rows, const double* from, const Target& column);
  void RoundColumn(int j, CameraSums* sums) const;
  /// Address of entry (r, c) of a block; the following rows of the column are contiguous.
  Target Block(CameraSums* sums, int column, int64_t entry, int r, int c) const;
  void PrefetchPair(int first, int second, CameraSums* sums) const;
  int64_t Entry(int column, int row) const { return structure_.Entry(column, row); }

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const BlockStructure& structure_;
  BlockStructure compact_;  ///< CompactStructure; used with error terms
  std::vector<ImageBlocks> images_;
  std::vector<int64_t> diagonal_begin_;
  bool has_shared_blocks_ = false;

  /// The map of an image's block, by its index in ParameterLayout::ImageBlocks and in ImageBlocks.
  struct MapOf {
    int image, place, k;
    size_t first;  ///< index of the first value of the map
  };
  std::vector<MapOf> maps_;
  std::vector<double> map_values_;
  std::vector<uint8_t> image_is_mapped_;  ///< per image; empty unless all maps are of sensors
};

}  // namespace bundle
