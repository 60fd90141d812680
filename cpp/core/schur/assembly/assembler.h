#pragma once

/// Assembly of S: adds a chunk's blocks of image pairs to blocks of the parameter layout.
///
/// The passes sum by parts of the camera parameters, with the columns that any image of the part
/// refines (schur/image_parts.h). In the layout, the unknowns of a part are one block or two: its
/// own block and one that several cameras share. Some columns may be constant. A block of parts (a,
/// b) is thus added to up to four blocks of S. If both have the same block of the layout, it and
/// its transpose are added to the diagonal block.
///
/// Several threads add chunks at the same time, but the sums must have the same bits in every run.
/// So each block of S belongs to one queue, and chunks are added to a queue in their order. The
/// blocks of an own part belong to its queue. The block of two own parts belongs to the queue of
/// the first. All blocks between shared cameras or sensors belong to one queue. Only this queue is
/// serial, and it is short.

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
#include "core/schur/image_parts.h"
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
    BlockValues values;
    std::vector<double> rhs, camera_diagonal, gradient, squared_norms;
  };
  bool has_error_terms = false;
  ErrorTerms error_terms;

  template <typename Vector>
  double* ErrorTermsOf(Vector* of) const {
    return has_error_terms ? of->data() : nullptr;
  }
};

class Assembler {
 public:
  /// Keeps references to all arguments. `by_parts`: the structure has a block per part, which is
  /// that part's only block, without a map (part_sums.h).
  Assembler(const AdjustmentProblem& problem, const ParameterLayout& layout,
            const ImageParts& parts, const Kernels& kernels, const BlockStructure& structure,
            bool by_parts = false);
  Assembler(const Assembler&) = delete;
  Assembler& operator=(const Assembler&) = delete;

  /// Lays out the error terms of S. Call before any error term is stored.
  void PlaceErrorTerms() { compact_ = CompactStructure(structure_); }

  /// Sets the maps at a state, before its chunks are added.
  void SetMaps(const CameraStates& cameras);
  /// True if there are maps. Chunks then need the camera_diagonal.
  bool has_maps() const { return !maps_.empty(); }

  /// The pairs of a chunk that contain one of its own parts, ascending.
  struct PairsOfPart {
    size_t first = 0, last = 0;  ///< [first, last): pairs with this part as first part
    const int* as_second = nullptr;
    size_t num_as_second = 0;
  };

  /// Adds the sums of a chunk for its own part i: its vectors, its diagonal block and its pairs.
  /// Leaves out sums between two shared blocks.
  void AddPart(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum, size_t i,
               const PairsOfPart& pairs, CameraSums* sums) const;

  /// Adds the sums of a chunk between shared blocks, after AddPart. Does nothing without shared
  /// blocks.
  void AddSharedBlocks(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum,
                       CameraSums* sums) const;

  /// Adds the vectors of a part, and the block diagonal where it is wanted. `vectors` and `squares`
  /// as in ChunkSum.
  void AddVectorsOf(int part, const double* vectors, const double* squares, CameraSums* sums) const;
  /// Adds a block of two parts to S, for block s of the first part and block t of the second one.
  /// Row-major with this width; of a part with itself, only the upper triangle is defined. The part
  /// with itself has each pair of its blocks once: the block of `s` is not after that of `t`.
  void AddBlockOf(int first, int s, int second, int t, const double* block, int width,
                  CameraSums* sums) const;

  /// Calls visit(l, k, m) for local columns l of a part and columns k of the layout: k moves l by
  /// m.
  template <typename Visit>
  void VisitMaps(int part, const Visit& visit) const {
    for (int s = 0; s < parts_[part].count; ++s) {
      const PartBlock& block = parts_[part].of[s];
      const int column = structure_.offset[block.block];
      for (int i = 0; i < block.num_local; ++i) {
        if (block.map == nullptr) {
          visit(block.local[i], column + i, 1.0);
          continue;
        }
        const double* const row = block.map + i * block.size;
        for (int j = 0; j < block.size; ++j) visit(block.local[i], column + j, row[j]);
      }
    }
  }

  /// Adds the error terms to the sums, after the last chunk. The sums are doubles afterwards.
  void Round(ThreadPool* pool, CameraSums* sums) const;

  /// S += damping D^2, and the same for the block diagonal, whose upper triangles it completes.
  void AddDamping(double damping, const std::vector<double>& d_squared, CameraSums* sums) const;

  /// Sets the rows and columns of the marked Jacobian columns in the sums to zero.
  void ClearColumns(const std::vector<uint8_t>& which, CameraSums* sums) const;

  /// The first entry of CameraSums::ErrorTerms::values for a block column, and their number.
  int64_t error_terms_begin(int block_column) const { return compact_.panel_begin[block_column]; }
  int64_t num_error_terms() const { return compact_.num_values; }

  /// True if several own parts depend on a block of the layout.
  bool own_parts_have_shared_blocks() const { return own_parts_have_shared_blocks_; }

  /// The blocks that a part's columns are added to: their number and the first.
  int num_blocks(int part) const { return parts_[part].count; }
  const PartBlock* blocks_of(int part) const { return parts_[part].of; }

  /// Begin of block j of the layout in BlockSystem::camera_diagonal.
  const std::vector<int64_t>& diagonal_begin() const { return diagonal_begin_; }

 private:
  struct PartBlocks {
    PartBlock of[5];
    int count = 0;
    int num_columns = 0;  ///< number of local columns
  };

  /// Segments of a part's columns to which a sum is added.
  enum class Segment { kOwn, kShared };
  /// Blocks of a pair to which a sum is added: those of the first part's own block; those of the
  /// second part's own block with shared blocks of the first; or those between shared blocks.
  enum class PairSegment { kFirst, kSecond, kShared };

  /// Consecutive sums and their error terms; nullptr: without error terms.
  struct Target {
    double* sum = nullptr;
    double* error = nullptr;
    void Add(int64_t i, double value) const;
  };

  void AddBlock(int part, int place);
  void AddWhole(int part);
  /// `squares`: A^T A of the part; only blocks with a map (PartBlock::map) use it.
  void AddVectors(int part, const double* vectors, const double* squares, Segment segment,
                  CameraSums* sums) const;
  void AddDiagonal(int part, const double* block, Segment segment, CameraSums* sums) const;
  void AddCameraDiagonal(int part, const double* block, Segment segment, CameraSums* sums) const;
  void AddPair(int first, int second, const double* block, PairSegment segment,
               CameraSums* sums) const;
  void AddDiagonalOf(int part, int s, int t, const double* block, int width,
                     CameraSums* sums) const;
  void AddPairOf(const PartBlock& a, const PartBlock& b, const double* block, int width,
                 CameraSums* sums) const;
  int WidthOf(int part) const { return 4 * image_parts_.part(part).num_quads; }
  void RoundColumn(int j, CameraSums* sums) const;
  /// Address of entry (r, c) of a block; the following rows of the column are contiguous.
  Target Block(CameraSums* sums, int column, int64_t entry, int r, int c) const;
  void PrefetchPair(int first, int second, CameraSums* sums) const;
  int64_t Entry(int column, int row) const { return structure_.Entry(column, row); }

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const ImageParts& image_parts_;
  const Kernels& kernels_;
  const BlockStructure& structure_;
  BlockStructure compact_;  ///< CompactStructure; used with error terms
  std::vector<PartBlocks> parts_;
  std::vector<int64_t> diagonal_begin_;
  bool own_parts_have_shared_blocks_ = false;

  /// The map of a part's block, by its index in ParameterLayout::ImageBlocks and in PartBlocks.
  struct MapOf {
    int part, place, k;
    size_t first;  ///< index of the first value of the map
  };
  std::vector<MapOf> maps_;
  std::vector<double> map_values_;
};

}  // namespace bundle
