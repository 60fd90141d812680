#pragma once

/// Initial poses of a pose graph by chordal relaxation (derived in chordal.cpp).

#include <vector>

#include "core/linear/fill_ordering.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Poses by chordal relaxation. `known` as in PatternOfEdges.
std::vector<double> ChordalPoses(const PoseGraph& graph, const double* information, int num_threads,
                                 const FillOrdering* known = nullptr);

}  // namespace bundle
