#pragma once

/// Pairs of images and points of a synthetic scene that could see each other.
///
/// Points are sorted into the cells of a grid over their keys. The candidates of an image are the
/// points in the cells that its ball may touch. If points have far more candidates than their
/// tracks need, candidates are dropped at random. With u uniform in [0, 1) and share_j = wanted_j /
/// views of its cell, candidate j is kept if u < share_j * richness; at least `fewest` are kept.
/// visible_points.h then selects the visible ones.

#include <cstdint>
#include <functional>
#include <vector>

#include "core/synthetic/visible_points.h"

namespace bundle {

/// View of the caller's arrays.
struct PointCells {
  int64_t num_cells = 0;
  const double* centers = nullptr;  ///< num_cells x 3, in the space of the keys
  double half_diagonal = 0;
  const int64_t* starts = nullptr;  ///< num_cells + 1: the first point of each cell, and the end
};

/// Pairs sorted by point, then image. `order` gives the numbers of points.
struct VisiblePairs {
  std::vector<int32_t> point;
  std::vector<int32_t> image;
};

/// `points` and `wanted` are in the order of the cells; `order` has the points' numbers. `uniform`
/// is called by this thread only, image by image in their order, so that the result does not depend
/// on the number of threads.
VisiblePairs FindVisiblePairs(const SyntheticImages& images, const SyntheticPoints& points,
                              const PointCells& cells, const int64_t* order, const double* wanted,
                              int64_t fewest, const std::function<double()>& uniform,
                              int num_threads);

}  // namespace bundle
