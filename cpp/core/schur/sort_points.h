#pragma once

/// Order of the points in an elimination plan.

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"
#include "core/schur/elimination_plan.h"

namespace bundle {

struct ImageOrder {
  std::vector<uint8_t> refined;  ///< per image: 1 if it has something to refine
  /// Place of each image: refined ones in the order of their blocks, which S likes best, then the
  /// others.
  std::vector<int> rank;
  /// Per image: the first of the images whose poses are in the same block, which are neighbours in
  /// the order. The image itself, except for images of a rig.
  std::vector<int> owner;
};

ImageOrder OrderImages(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// Makes a plan without chunks and references to them: the points with observations that have
/// something to refine, if `active`, or else with others, by sections if `in_sections`, and sorted
/// lexicographically by the ranks of the images in these observations.
EliminationPlan SortPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageOrder& images, bool active, bool in_sections, int num_threads,
                           bool keep_order);

}  // namespace bundle
