#pragma once

#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "core/schur/point_entries.h"

namespace bundle {

class Communicator;
class ThreadPool;

/// Cuts the points of a sorted plan into chunks with their tiles, and writes the entries of its
/// observations. `in_sections`: no chunk crosses a section. Chunks do not depend on the number of
/// threads. `communicator`: the ranks whose plans together cover the problem; nullptr: this plan.
void CutIntoChunks(const ImageParts& parts, const PointSizes& sizes, bool in_sections,
                   Communicator* communicator, ThreadPool* pool, EliminationPlan* plan);

}  // namespace bundle
