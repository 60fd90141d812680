#pragma once

/// Contents of a COLMAP model that are not in a problem.

#include <cstdint>
#include <vector>

#include "core/io/colmap_model.h"

namespace bundle {

/// The keypoints of a model that was read, in the order of its files. Both functions read a file
/// again, and throw InputError if it has changed.
std::vector<double> ReadKeypoints(const ColmapModel& model);

/// Points of a model that was read, in the order of its files.
struct ColmapTracks {
  std::vector<int64_t> point_ids;
  std::vector<uint8_t> colors;  ///< three per point
  std::vector<int64_t> lengths;
  std::vector<ColmapIndex::TrackElement> elements;
};
ColmapTracks ReadTracks(const ColmapModel& model);

}  // namespace bundle
