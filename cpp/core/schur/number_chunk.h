#pragma once

#include <cstdint>
#include <vector>

#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "core/schur/point_entries.h"

namespace bundle {

/// A chunk before its parts are sorted: the number of the block of each pair of entries, in the
/// order of their points, and the images that it numbered.
struct ChunkDraft {
  std::vector<uint16_t> pair_numbers;
  std::vector<int> images;
};

/// Sorts parts and pairs of a chunk, so that adding it accesses S in ascending order, and cuts it
/// into tiles with their lists. Writes the entries of its observations to the plan, and empties the
/// draft. Chunks of different points may be numbered at the same time.
void NumberChunk(const ImageParts& parts, const PointSizes& sizes, ChunkDraft* draft, Chunk* chunk,
                 EliminationPlan* plan);

}  // namespace bundle
