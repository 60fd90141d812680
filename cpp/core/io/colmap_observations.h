#pragma once

#include <cstdint>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

/// The observations of a model as our problem has them: images and points are counted in the order
/// of their ids, the rows sorted by point, then image, then keypoint.
struct ColmapObservations {
  std::vector<int32_t> image;
  std::vector<int32_t> point;
  std::vector<int32_t> keypoint;
  std::vector<double> xy;  ///< two a row
};

/// `point_of_keypoint` is what CheckColmapReferences returned for this index.
ColmapObservations SortColmapObservations(const ColmapIndex& index,
                                          const std::vector<int64_t>& point_of_keypoint);

}  // namespace bundle
