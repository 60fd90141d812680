#include "core/checking/lost_observations.h"

/// Observations behind their cameras at the end of a solve, and the resulting status of the
/// solution.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <sstream>
#include <string>
#include <vector>

#include "core/problem/reprojection_errors.h"
#include "core/scratch/large_vector.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

/// 1 for observations that do not count.
LargeVector<uint8_t> FindBehind(const AdjustmentProblem& problem, const SolveOptions& options) {
  LargeVector<double> errors(problem.num_observations);
  LargeVector<uint8_t> behind(problem.num_observations);
  ComputeReprojectionErrors(problem, options.num_threads, options.cheirality, errors.data(),
                            behind.data());
  if (options.cheirality == Cheirality::kAlgebraic) {
    for (size_t i = 0; i < behind.size(); ++i) behind[i] = std::isnan(errors[i]) ? 1 : 0;
  }
  return behind;
}

int64_t CountLeftOut(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const LargeVector<uint8_t>& behind, int64_t num_held) {
  int64_t num_refined_behind = 0;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    if (behind[i] && layout.IsRefined(problem, i)) ++num_refined_behind;
  }
  return num_held - SumOverRanks(problem.division.communicator, num_refined_behind);
}

int64_t Count(const LargeVector<uint8_t>& flags) {
  return std::accumulate(flags.begin(), flags.end(), int64_t{0});
}

/// Ids of the images whose observations are all behind the camera.
std::vector<int64_t> ImagesWithNoneInFront(const AdjustmentProblem& problem,
                                           const LargeVector<uint8_t>& behind) {
  std::vector<uint8_t> seen(problem.num_images), in_front(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    seen[problem.observation_image[i]] = 1;
    if (!behind[i]) in_front[problem.observation_image[i]] = 1;
  }
  JoinOverRanks(problem.division.communicator, &seen);
  JoinOverRanks(problem.division.communicator, &in_front);
  std::vector<int64_t> ids;
  for (int i = 0; i < problem.num_images; ++i) {
    if (seen[i] && !in_front[i]) ids.push_back(problem.image_ids[i]);
  }
  return ids;
}

/// "image 3", "images 3, 5 and 9", "images 1, 2, 3, 4, 5 and 12 more"
std::string NameImages(const std::vector<int64_t>& ids) {
  constexpr size_t kNamed = 5;
  const size_t named = ids.size() > kNamed + 1 ? kNamed : ids.size();
  std::ostringstream text;
  text << (ids.size() == 1 ? "image " : "images ");
  for (size_t i = 0; i < named; ++i) {
    text << (i == 0 ? "" : i + 1 == ids.size() ? " and " : ", ") << ids[i];
  }
  if (named < ids.size()) text << " and " << ids.size() - named << " more";
  return text.str();
}

}  // namespace

int64_t CountLeftOut(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const SolveOptions& options, int64_t num_held) {
  return CountLeftOut(problem, layout, FindBehind(problem, options), num_held);
}

void JudgeLostObservations(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output) {
  AdjustmentProblem refined = problem;
  refined.cam_from_world = output->cam_from_world.data();
  refined.camera_params = output->camera_params.data();
  refined.points = output->points.data();
  output->PutShutters(&refined);
  const LargeVector<uint8_t> before = FindBehind(problem, options);
  const LargeVector<uint8_t> after = FindBehind(refined, options);
  Communicator* const communicator = problem.division.communicator;
  const int64_t num_before = SumOverRanks(communicator, Count(before));
  const int64_t num_after = SumOverRanks(communicator, Count(after));
  const int64_t num_observations = SumOverRanks(communicator, problem.num_observations);
  int64_t num_lost = 0;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    if (after[i] && !before[i]) ++num_lost;
  }
  num_lost = SumOverRanks(communicator, num_lost);
  const int64_t num_left_out = CountLeftOut(problem, layout, after, num_held);
  const int64_t num_counted = num_observations - num_before;
  const bool unusable =
      static_cast<double>(num_lost) > kMaxLostShare * static_cast<double>(num_counted);
  const auto warn = [output](WarningKind kind, const std::ostringstream& sentence) {
    Warn(kind, sentence.str(), &output->summary.warnings);
  };
  if (num_after == num_observations) {
    output->summary.is_solution_usable = false;
    output->summary.termination_type = "FAILURE";
    output->summary.message = "No observation has a projection: there is nothing to fit.";
    std::ostringstream sentence;
    sentence << "The solution is not usable: none of the " << num_observations
             << " observations has a projection, "
             << (num_before == num_observations ? "and none had one at the start."
                                                : "though some had one at the start.");
    warn(WarningKind::kNoProjection, sentence);
    return;
  }
  const std::vector<int64_t> images = ImagesWithNoneInFront(problem, after);
  if (num_after > num_before || !images.empty() || unusable) {
    std::ostringstream sentence;
    sentence << num_after << " of " << num_observations
             << (options.cheirality != Cheirality::kAlgebraic
                     ? " observations are behind their cameras"
                     : " observations have no projection")
             << " at the end, " << num_before << " at the start";
    if (!images.empty()) {
      sentence << "; " << NameImages(images) << (images.size() == 1 ? " has" : " have")
               << " no observation in front of the camera";
    }
    sentence << ".";
    warn(WarningKind::kObservationsBehind, sentence);
  }
  if (unusable) {
    output->summary.is_solution_usable = false;
    std::ostringstream sentence;
    sentence << "The solution is not usable: of the " << num_counted
             << " observations in front of their cameras at the start, " << num_lost
             << " went behind, more than 1 %.";
    warn(WarningKind::kTooManyBehind, sentence);
  }
  if (num_left_out > 0) {
    std::ostringstream sentence;
    const bool one = num_left_out == 1;
    sentence << num_left_out << (one ? " observation" : " observations")
             << " in front of the camera at the end " << (one ? "was" : "were")
             << " left out of the solve because " << (one ? "it was" : "they were")
             << " behind it before; refine again to include " << (one ? "it" : "them") << ".";
    warn(WarningKind::kObservationsLeftOut, sentence);
  }
}

}  // namespace bundle
