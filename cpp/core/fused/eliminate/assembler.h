#pragma once

/// Where a chunk's sums go: from blocks of image pairs to blocks of the parameter layout.
///
/// The passes work by image, with the columns that any image of its camera model refines: its pose,
/// then its intrinsics. In the layout, an image's columns are one block, or two where the
/// intrinsics are shared with other images, and some may be fixed. A block of images (a, b) thus
/// goes to up to four blocks of S. Where both have the same intrinsics block, it and its transpose
/// go to the diagonal one.

#include <cstdint>
#include <vector>

#include "core/fused/eliminate/kernels.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

/// The camera side of the normal equations.
struct CameraSums {
  ReducedSystem system;
  std::vector<double> gradient;       ///< J_c^T r
  std::vector<double> squared_norms;  ///< ||J e_j||^2
};

class Assembler {
 public:
  /// `groups` and `image_group` as in Terms.
  Assembler(const ProblemView& problem, const ParameterLayout& layout,
            const std::vector<ModelGroup>& groups, const std::vector<uint8_t>& image_group,
            const ReducedStructure& structure);

  /// Adds what a chunk has of image i of its images: its vectors, its diagonal block, and the pairs
  /// [first_pair, last_pair), whose first it is.
  void AddImage(const Terms& terms, const Chunk& chunk, const ChunkSum& sum, size_t i,
                size_t first_pair, size_t last_pair, CameraSums* sums) const;

  /// True if AddImage changes no other block columns of S than the image's own.
  bool images_are_independent() const { return images_are_independent_; }

  /// Where block j of the layout begins in ReducedSystem::camera_diagonal.
  const std::vector<int64_t>& diagonal_begin() const { return diagonal_begin_; }

 private:
  /// Columns of an image that are in one block of the layout.
  struct Segment {
    int block = -1;
    int size = 0;
    bool is_contiguous = true;                        ///< local[k] = local[0] + k
    int8_t local[kPoseSize + kMaxCameraParams] = {};  ///< entry k of the block by local column
  };
  struct ImageSegments {
    Segment of[2];
    int count = 0;
  };

  void AddSegment(int block, const ParameterLayout& layout, const ModelGroup& group,
                  ImageSegments* image) const;
  void AddVectors(const Terms& terms, int image, const double* vectors, CameraSums* sums) const;
  void AddDiagonal(const Terms& terms, int image, const double* block, double* values) const;
  void AddCameraDiagonal(const Terms& terms, int image, const double* block, double* values) const;
  void AddPair(const Terms& terms, int first, int second, const double* block,
               double* values) const;
  static void AddColumn(const Segment& rows, const double* from, double* column);
  void PrefetchPair(int first, int second, const double* values) const;
  int64_t Entry(int column, int row) const;

  const ReducedStructure& structure_;
  std::vector<ImageSegments> images_;
  std::vector<int64_t> diagonal_begin_;
  bool images_are_independent_ = true;
};

}  // namespace bundle::fused
