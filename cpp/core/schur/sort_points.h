#pragma once

/// Order of the points in an elimination plan.

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"
#include "core/schur/elimination_plan.h"

namespace bundle {

class ThreadPool;

struct ImageOrder {
  std::vector<uint8_t> refined;  ///< per image: 1 if it has something to refine
  /// Place of each image: refined images in the order of their blocks, the best order for access to
  /// S, then all other images.
  std::vector<int> rank;
};

ImageOrder OrderImages(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// Makes a plan without chunks, and references to its observations. If `active`, it has the points
/// with observations that have free parameters, or else the points with other observations. Points
/// are sorted by sections if `in_sections`, then lexicographically by the ranks of the images in
/// these observations.
EliminationPlan SortPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageOrder& images, bool active, bool in_sections,
                           ThreadPool* pool, bool keep_order);

/// Copies the changed measurements of the problem into a plan that kept its order.
void TakeMeasurements(const AdjustmentProblem& problem, EliminationPlan* plan);

}  // namespace bundle
