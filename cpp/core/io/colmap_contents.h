#pragma once

/// Contents of a COLMAP model that are not in a problem.

#include <cstdint>
#include <vector>

#include "core/io/colmap_model.h"

namespace bundle {

/// The keypoints of a model that was read, in the order of its files.
std::vector<double> ReadKeypoints(const ColmapModel& model);

/// Colours and tracks of a model that was read, in the order of its files.
struct ColmapTracks {
  std::vector<uint8_t> colors;  ///< three per point
  std::vector<int64_t> lengths;
  std::vector<ColmapIndex::TrackElement> elements;
};
ColmapTracks ReadTracks(const ColmapModel& model);

}  // namespace bundle
