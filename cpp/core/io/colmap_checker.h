#pragma once

/// Checks of COLMAP models.

#include <cstdint>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

class IdMap;  // colmap_id_map.h

/// Scans a model without checking references. Like COLMAP, prefers binary files if the folder has
/// both formats.
ColmapIndex ScanColmapModel(const std::string& folder);

/// Checks rigs, cameras, frames and images: unique ids, references that resolve. Throws InputError
/// as the scanners do and, unless `may_be_empty`, if there is no camera or no image. Returns the
/// positions of the images.
IdMap CheckColmapViews(const ColmapIndex& index, bool may_be_empty = false);

/// Checks views, and points with their tracks. Returns the position in `points` of the point of
/// each keypoint that has one, in the order of `keypoints`.
std::vector<int32_t> CheckColmapReferences(const ColmapIndex& index, bool may_be_empty = false);

}  // namespace bundle
