#pragma once

#include <atomic>
#include <memory>

#include "core/ceres/ceres_version.h"
#include "core/problem/problem_view.h"
#include "core/solve/camera_states.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// What all reprojection costs of a solve share. Outlives them.
struct ReprojectionContext {
  const ProblemView& problem;
  const ParameterLayout& layout;
  const CameraStates& states;
  Cheirality cheirality;
  /// Where it is true, costs cannot be evaluated any more, so that Ceres ends. Not read if null.
  const std::atomic<bool>* abandoned = nullptr;
};

/// The residual of one observation as Ceres sees it. Its parameter blocks are, in this order and as
/// far as they are free: the point, the image's block, the shared camera's block.
///
/// The camera side is read from `context.states`, not from the parameters: an EvaluationCallback
/// keeps the two equal. The model is one of the registry's and known.
std::unique_ptr<ceres::CostFunction> MakeReprojectionCost(const ReprojectionContext& context,
                                                          int64_t observation);

}  // namespace bundle
