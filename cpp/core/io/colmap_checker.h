#pragma once

/// Checks of COLMAP models.

#include <cstdint>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

class IdMap;  // colmap_id_map.h

/// The scan alone, without the check of references; binary files where the folder holds both
/// formats, as COLMAP.
ColmapIndex ScanColmapModel(const std::string& folder);

/// Checks rigs, cameras, frames and images: unique ids, references that resolve. Throws InputError
/// as the scanners do, and unless `may_be_empty` where there is no camera or no image. Returns the
/// positions of the images.
IdMap CheckColmapViews(const ColmapIndex& index, bool may_be_empty = false);

/// Checks views, and points with their tracks. Returns the position in `points` of each keypoint's
/// point, -1 where it has none.
std::vector<int64_t> CheckColmapReferences(const ColmapIndex& index, bool may_be_empty = false);

}  // namespace bundle
