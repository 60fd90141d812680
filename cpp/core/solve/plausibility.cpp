#include "core/solve/plausibility.h"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <vector>

#include "core/error.h"
#include "core/problem/reprojection_errors.h"
#include "core/problem/validate.h"

namespace bundle {

std::string CountPointsSeenOnce(const ProblemView& problem, const ParameterLayout& layout,
                                const std::vector<int64_t>& track_lengths) {
  int64_t count = 0;
  int first = -1;
  for (int p = 0; p < problem.num_points; ++p) {
    if (track_lengths[p] != 1 || !layout.point_is_free(p)) continue;
    if (count++ == 0) first = p;
  }
  if (count == 0) return "";
  return "Points seen only once have no depth of their own, the damping alone holds them: " +
         std::to_string(count) + ", the first is point " +
         std::to_string(problem.point_ids[first]) + ".";
}

bool RejectImpossibleSolution(const ProblemView& problem, SolveOutput* output) {
  ProblemView refined = problem;
  refined.cam_from_world = output->cam_from_world.data();
  refined.camera_params = output->camera_params.data();
  refined.points = output->points.data();
  try {
    ValidateProblem(refined);
    return false;
  } catch (const InputError& error) {
    const auto restore = [](const double* from, std::vector<double>* to) {
      to->assign(from, from + to->size());
    };
    restore(problem.cam_from_world, &output->cam_from_world);
    restore(problem.camera_params, &output->camera_params);
    restore(problem.points, &output->points);
    output->summary.is_solution_usable = false;
    Warn(WarningKind::kInvalidSolution,
         std::string("The solution is invalid (") + error.what() + ") and was discarded.",
         &output->summary.warnings);
    return true;
  }
}

std::string FindOverflow(const ProblemView& problem, Cheirality cheirality) {
  std::vector<double> errors(problem.num_observations);
  std::vector<uint8_t> behind(problem.num_observations);
  ComputeReprojectionErrors(problem, 1, errors.data(), behind.data());
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const bool counts =
        !std::isnan(errors[i]) && (!behind[i] || cheirality == Cheirality::kAlgebraic);
    if (!counts || std::isfinite(errors[i] * errors[i])) continue;
    std::ostringstream sentence;
    sentence << "The squared residual of image " << problem.image_ids[problem.observation_image[i]]
             << ", point " << problem.point_ids[problem.observation_point[i]]
             << " is not finite at the start (" << errors[i] << " pixels).";
    return sentence.str();
  }
  return "";
}

}  // namespace bundle
