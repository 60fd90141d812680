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
/// once per pair of observations.
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

/// Maximum columns of two parts in whole quads, and therefore of two blocks' unknowns.
inline constexpr int kMaxMapped = (kImageColumns + 3) / 4 * 4 * kImageColumns;

/// to = sum over k of factor[index[k] * stride] times row k of a matrix with `size` columns. If
/// kSize is not 0, it equals `size`.
template <int kSize>
inline void CombineRows(const double* factor, const int8_t* index, int stride, int count,
                        const double* rows, int size, double* to) {
  constexpr int kMax = kSize > 0 ? kSize : kImageColumns;
  const int columns = kSize > 0 ? kSize : size;
  double sum[kMax] = {};
  for (int k = 0; k < count; ++k) {
    const double f = factor[index[k] * stride];
    for (int j = 0; j < columns; ++j) sum[j] += f * rows[k * columns + j];
  }
  for (int j = 0; j < columns; ++j) to[j] = sum[j];
}

inline void CombineRows(const double* factor, const int8_t* index, int stride, int count,
                        const double* rows, int size, double* to) {
  if (size == kPoseSize) {
    CombineRows<kPoseSize>(factor, index, stride, count, rows, size, to);
  } else {
    CombineRows<0>(factor, index, stride, count, rows, size, to);
  }
}

/// out = M_a^T B M_b, a.size x b.size, of a block B whose rows are a's local columns, each `width`
/// long.
inline void MapBlock(const PartBlock& a, const PartBlock& b, const double* block, int width,
                     double* out) {
  double right[kMaxMapped];  // B M_b
  double* const by_rows = a.map == nullptr ? out : right;
  for (int i = 0; i < a.num_local; ++i) {
    const double* const row = block + a.local[i] * width;
    double* const to = by_rows + i * b.size;
    if (b.map == nullptr) {
      for (int j = 0; j < b.size; ++j) to[j] = row[b.local[j]];
      continue;
    }
    CombineRows(row, b.local, 1, b.num_local, b.map, b.size, to);
  }
  if (a.map == nullptr) return;
  constexpr int8_t kInTurn[] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13,
                                14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27};
  static_assert(sizeof kInTurn == kImageColumns);
  for (int u = 0; u < a.size; ++u) {
    CombineRows(a.map + u, kInTurn, a.size, a.num_local, right, b.size, out + u * b.size);
  }
}

/// Fills both triangles of a symmetric block whose upper triangle is defined; `size` local columns.
inline void FillLower(const double* upper, int size, int width, double* full) {
  for (int i = 0; i < size; ++i) {
    for (int j = i; j < size; ++j) full[i * width + j] = full[j * width + i] = upper[i * width + j];
  }
}

}  // namespace bundle
