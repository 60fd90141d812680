#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/residuals/reprojection.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/solve.h"

namespace bundle {

/// One sentence that counts the free points seen by one observation only; "" if there are none.
std::string CountPointsSeenOnce(const ProblemView& problem, const ParameterLayout& layout,
                                const std::vector<int64_t>& track_lengths);

/// If the solver left something that is no reconstruction (a focal length that is not positive, a
/// number that is not finite), puts the problem's own values back, marks the solution as not usable
/// and says why in the warnings. Returns true if so.
bool RejectImpossibleSolution(const ProblemView& problem, SolveOutput* output);

/// One sentence that names the first observation whose squared residual is not finite at the
/// problem's own values; "" if there is none.
std::string FindOverflow(const ProblemView& problem, Cheirality cheirality);

}  // namespace bundle
