#pragma once

/// Places of the contributions of edges in the normal equations of a pose graph.

#include <algorithm>
#include <cstdint>

#include "core/linear/block_structure.h"
#include "core/pose_graph/edge_kernel.h"

namespace bundle {

/// Places of an edge's blocks; column -1 for a constant pose.
struct EdgePlace {
  int i = -1, j = -1;  ///< block columns of its poses
  int64_t below = 0;   ///< values of the block below the diagonal
  int stride_below = 0;
};

inline EdgePlace FindPlace(const BlockStructure& structure, int i, int j) {
  EdgePlace place{i, j};
  if (i < 0 || j < 0) return place;
  const int column = std::min(i, j), row = std::max(i, j);
  place.below = structure.ValueIndex(column, structure.Entry(column, row), 0, 0);
  place.stride_below = structure.panel_stride[column];
  return place;
}

/// First value of a diagonal block.
inline int64_t DiagonalIndex(const BlockStructure& structure, int block) {
  return structure.ValueIndex(block, structure.column_begin[block], 0, 0);
}

/// Adds the terms of an edge (edge_kernel.h) to the block columns [first, last) of the values, and
/// to their gradient.
template <typename Group>
void AddEdge(const BlockStructure& structure, const EdgePlace& place, const double* terms,
             int first, int last, double* values, double* gradient) {
  using Terms = EdgeTerms<Group>;
  constexpr int kSize = Group::kTangent;
  const auto is_mine = [&](int block) { return block >= first && block < last; };
  const auto add_pose = [&](int block, const double* triangle, const double* of_pose) {
    double* column = values + DiagonalIndex(structure, block);
    for (int c = 0; c < kSize; ++c, column += structure.panel_stride[block]) {
      for (int r = c; r < kSize; ++r) column[r] += *triangle++;
      gradient[int64_t{block} * kSize + c] += of_pose[c];
    }
  };
  if (is_mine(place.i)) add_pose(place.i, terms + Terms::kIi, terms + Terms::kGi);
  if (is_mine(place.j)) add_pose(place.j, terms + Terms::kJj, terms + Terms::kGj);
  if (place.i < 0 || place.j < 0 || !is_mine(std::min(place.i, place.j))) return;
  const double* const matrix = terms + Terms::kIj;
  double* column = values + place.below;
  const bool rows_are_j = place.j > place.i;
  for (int c = 0; c < kSize; ++c, column += place.stride_below) {
    for (int r = 0; r < kSize; ++r) {
      column[r] += matrix[rows_are_j ? c * kSize + r : r * kSize + c];
    }
  }
}

}  // namespace bundle
