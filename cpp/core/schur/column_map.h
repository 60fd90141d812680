#pragma once

/// Maps from the unknowns of a block to the columns of a part.
///
/// The passes sum by parts (image_parts.h): blocks S_ab, and vectors g, by the columns of their
/// Jacobians A_a, the *local columns* of a part. Most unknowns are such columns, and their sums
/// only have to be selected. If a step u of some unknowns moves the local columns by M_a u, their
/// Jacobian is A_a M_a. So
///
///   S_ab goes to M_a^T S_ab M_b,    g_a to M_a^T g_a,    ||J e_j||^2 is (M_a^T A_a^T A_a M_a)_jj,
///
/// where the last needs all entries of A_a^T A_a. This is computed once per block of a chunk, not
/// once per pair of observations (kernels/map_block.h).
///
/// Maps are, for instance, from one focal length to fx and fy, or from a rotation about a fixed
/// centre to a pose. A map that differs between the images of a part, such as that of a sensor, is
/// applied to the Jacobian of each observation instead (kernels/eliminate_chunk.h). To add a map,
/// fill in a PartBlock (assembler.cpp, AddBlock) and lay out its block. Implement the same map for
/// steps (state_records.cpp, CameraStep), for factors (model/problem_factors.h) and for Ceres
/// (ceres/reprojection_cost.h).

#include <cstdint>

#include "core/model/parameter_layout.h"

namespace bundle {

/// Local columns of a part that one block of the layout moves, and their map.
struct PartBlock {
  int block = -1;
  int size = 0;               ///< number of unknowns of the block
  bool is_shared = false;     ///< other own parts may depend on the block
  bool is_contiguous = true;  ///< local[k] = local[0] + k
  int num_local = 0;          ///< number of local columns; equals `size` without a map
  int8_t local[kImageColumns] = {};
  /// M without its zero rows, num_local x size; nullptr: unknown k is local column k.
  const double* map = nullptr;

  /// Map of a block whose unknowns equal its local columns.
  PartBlock WithoutMap() const {
    PartBlock plain = *this;
    plain.map = nullptr;
    plain.num_local = size;
    for (int k = 0; k < size; ++k) plain.local[k] = static_cast<int8_t>(k);
    plain.is_contiguous = true;
    return plain;
  }
};

/// Columns of a part in whole quads. Kernels::map_block reads that many numbers from the begin of
/// each row of a map.
inline constexpr int kMaxMapColumns = (kImageColumns + 3) / 4 * 4;
/// Most values of a block of two parts, before and after mapping.
inline constexpr int kMaxMapped = kMaxMapColumns * (kImageColumns + 1);

/// Fills both triangles of a symmetric block whose upper triangle is defined; `size` local columns.
inline void FillLower(const double* upper, int size, int width, double* full) {
  for (int i = 0; i < size; ++i) {
    for (int j = i; j < size; ++j) full[i * width + j] = full[j * width + i] = upper[i * width + j];
  }
}

}  // namespace bundle
