#pragma once

#include "core/ceres/ceres_version.h"
#include "core/problem/problem_view.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/summary.h"

namespace bundle {

/// What Ceres factorises with the linear solver that it used, `type`. Ceres does not tell: sparse
/// factors are counted here, on the pattern that Ceres builds and in CHOLMOD's AMD order of its
/// blocks. Ceres asks CHOLMOD for the same kind of order but numbers the blocks its own way and may
/// have it keep the groups of the ordering apart, so that its factor can be some per cent larger or
/// smaller. The symbolic time is that of this count.
FactorSummary CountCeresFactor(const ProblemView& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type);

}  // namespace bundle
