#include "core/checking/check_solution.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <sstream>
#include <utility>
#include <vector>

#include "core/checking/convergence_watch.h"
#include "core/checking/lost_observations.h"
#include "core/checking/steep_end.h"
#include "core/error.h"
#include "core/interface/adjustment_problem.h"
#include "core/problem/reprojection_errors.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

// Checking an observation takes 3 to 5 microseconds, about as long as a step of a solve spends on
// one. Checking a hundredth of them takes about a thousandth of a solve.
constexpr int64_t kSmallestSample = 32;
constexpr int64_t kLargestSample = 256;
constexpr int64_t kObservationsPerSample = 100;

/// splitmix64 (Steele, Lea and Flood, OOPSLA 2014) of a counter: a uniform number in [0, 1).
double Uniform(int counter) {
  uint64_t z = (static_cast<uint64_t>(counter) + 1) * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

}  // namespace

std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size) {
  std::vector<int64_t> observed(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) ++observed[problem.observation_image[i]];
  std::map<const CameraModel*, int64_t> images;  // number of images with observations
  const auto model_of = [&](int image) {
    return problem.camera_models[problem.image_camera[image]];
  };
  for (int i = 0; i < problem.num_images; ++i) {
    if (observed[i] > 0) ++images[model_of(i)];
  }
  // Each image samples at equal distances, from a random start.
  std::vector<double> share(problem.num_images), due(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    if (observed[i] == 0) continue;
    const auto drawn = static_cast<double>(size) / (static_cast<double>(images.size()) *
                                                    static_cast<double>(images[model_of(i)]));
    share[i] = std::min(1.0, drawn / static_cast<double>(observed[i]));
    due[i] = Uniform(i);
  }
  std::vector<int64_t> sample;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i];
    due[image] += share[image];
    if (due[image] < 1) continue;
    due[image] -= 1;
    sample.push_back(i);
  }
  return sample;
}

std::string CountPointsSeenOnce(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const LargeVector<int64_t>& track_lengths) {
  int64_t count = 0;
  int first = -1;
  for (int p = 0; p < problem.num_points; ++p) {
    if (track_lengths[p] != 1 || !layout.point_is_free(p)) continue;
    if (count++ == 0) first = p;
  }
  count = SumOverRanks(problem.division.communicator, count);
  const std::string first_id =
      FirstOverRanks(problem.division.communicator,
                     first < 0 ? std::string() : std::to_string(problem.point_ids[first]));
  if (count == 0) return "";
  return "Only the damping determines the depth of points with one observation: " +
         std::to_string(count) + " points, the first is point " + first_id + ".";
}

bool RejectImpossibleSolution(const AdjustmentProblem& problem, SolveOutput* output) {
  ProblemView refined = problem;
  refined.cam_from_world = output->cam_from_world.data();
  refined.rig_from_world = output->rig_from_world.data();
  refined.sensor_from_rig = output->sensor_from_rig.data();
  refined.camera_params = output->camera_params.data();
  refined.points = output->points.data();
  output->PutShutters(&refined);
  std::string found;
  try {
    ValidateState(refined);  // all other values are constant during a solve
  } catch (const InputError& error) {
    found = error.what();
  }
  found = FirstOverRanks(problem.division.communicator, found);
  if (found.empty()) return false;
  const auto restore = [](const double* from, auto* to) { to->assign(from, from + to->size()); };
  restore(problem.cam_from_world, &output->cam_from_world);
  restore(problem.rig_from_world, &output->rig_from_world);
  restore(problem.sensor_from_rig, &output->sensor_from_rig);
  restore(problem.camera_params, &output->camera_params);
  restore(problem.points, &output->points);
  output->summary.is_solution_usable = false;
  Warn(WarningKind::kInvalidSolution, "The solution is invalid (" + found + ") and was discarded.",
       &output->summary.warnings);
  return true;
}

std::string FindOverflow(const ProblemView& problem, Cheirality cheirality) {
  LargeVector<double> errors(problem.num_observations);
  LargeVector<uint8_t> behind(problem.num_observations);
  ComputeReprojectionErrors(problem, 1, cheirality, errors.data(), behind.data());
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const bool counts =
        !std::isnan(errors[i]) && (!behind[i] || cheirality == Cheirality::kAlgebraic);
    const double sigma = problem.observation_sigma == nullptr ? 1 : problem.observation_sigma[i];
    if (!counts || std::isfinite(errors[i] / sigma * (errors[i] / sigma))) continue;
    std::ostringstream sentence;
    sentence << "The squared residual of image " << problem.image_ids[problem.observation_image[i]]
             << ", point " << problem.point_ids[problem.observation_point[i]]
             << " is not finite at the start (" << errors[i] << " pixels).";
    return sentence.str();
  }
  return "";
}

SolutionUnderCheck::SolutionUnderCheck(const AdjustmentProblem& problem,
                                       const ParameterLayout& layout, const CameraStates& states,
                                       const LargeVector<double>& points, Cheirality cheirality)
    : problem_(problem),
      layout_(layout),
      states_(states),
      points_(points),
      cheirality_(cheirality) {}

uint32_t SolutionUnderCheck::FreeColumns(int64_t observation) const {
  const int image = problem_.observation_image[observation];
  const int camera = problem_.image_camera[image];
  const uint32_t columns = layout_.RefinedColumns(problem_, image);
  uint32_t free = columns & ((1u << kFirstTwist) - 1);
  // In local coordinates, all six pose numbers of a rig image may change.
  const bool has_sensor = layout_.blocks_of(image)[ParameterLayout::kSensorBlock] >= 0;
  const bool moves = has_sensor || (free & FreeParameters::kWholePose) != 0;
  if (problem_.FrameOf(image) >= 0 && moves) free |= FreeParameters::kWholePose;
  const int first_of_point = kPoseSize + problem_.camera_models[camera]->num_params;
  if (layout_.point_is_free(problem_.observation_point[observation])) free |= 7u << first_of_point;
  return free | columns >> kFirstTwist << (first_of_point + 3);
}

std::vector<ObservationAtPoint> SolutionUnderCheck::Sample() const {
  const int64_t size = std::clamp(problem_.num_observations / kObservationsPerSample,
                                  kSmallestSample, kLargestSample);
  std::vector<ObservationAtPoint> sample;
  for (const int64_t observation : SampleObservations(problem_, size)) {
    const int image = problem_.observation_image[observation];
    const int camera = problem_.image_camera[image];
    ObservationAtPoint at;
    at.observation = observation;
    at.model = problem_.camera_models[camera];
    at.rolls = states_.shutter(image) != nullptr;
    at.free = FreeColumns(observation);
    if (at.free == 0) continue;
    states_.Chart(image, at.x);
    double* x = at.x + kPoseSize;
    x = std::copy_n(states_.params(camera), at.model->num_params, x);
    x = std::copy_n(&points_[3 * int64_t{problem_.observation_point[observation]}], 3, x);
    if (at.rolls) std::copy_n(states_.twist(image), kTwistSize, x);
    sample.push_back(at);
  }
  return sample;
}

bool SolutionUnderCheck::operator()(int64_t observation, const double* x, double* residual,
                                    double* jacobian) const {
  const int image = problem_.observation_image[observation];
  const double* measurement = problem_.observation_xy + 2 * observation;
  PoseState pose;
  ExpandPose(states_.chart_rotation(image), x, &pose);
  const CameraModel& model = *problem_.camera_models[problem_.image_camera[image]];
  const double *params = x + kPoseSize, *point = params + model.num_params;
  ImageShutter moving;
  const ImageShutter* shutter = states_.shutter(image);
  if (shutter != nullptr) {
    moving = *shutter;
    std::copy_n(point + 3, kTwistSize, moving.twist);
    shutter = &moving;
  }
  ReprojectionJacobian parts;
  const bool counts =
      EvaluateReprojection(model, pose, params, point, measurement, cheirality_, residual,
                           jacobian == nullptr ? nullptr : &parts, shutter);
  for (int row = 0; jacobian != nullptr && row < 2; ++row) {
    jacobian = std::copy_n(parts.pose + kPoseSize * row, kPoseSize, jacobian);
    jacobian = std::copy_n(parts.params + model.num_params * row, model.num_params, jacobian);
    jacobian = std::copy_n(parts.point + 3 * row, 3, jacobian);
    if (shutter == nullptr) continue;
    jacobian = std::copy_n(parts.twist + kTwistSize * row, kTwistSize, jacobian);
  }
  return counts;
}

std::string CheckSolution(const AdjustmentProblem& problem, const ParameterLayout& layout,
                          const CameraStates& states, const LargeVector<double>& points,
                          Cheirality cheirality) {
  const SolutionUnderCheck solution(problem, layout, states, points, cheirality);
  return SpotCheck(solution.Sample(), std::cref(solution));
}

/// Ceres treats a NaN gradient as smaller than any tolerance and reports convergence.
void JudgeEnd(bool has_bounds, double function_tolerance, SolveRecord* record) {
  SolveSummary& summary = record->summary;
  const bool has_cost = std::isfinite(summary.final_cost);
  const bool is_finite = record->iterations.empty() ||
                         (has_cost && std::isfinite(record->iterations.back().gradient_max_norm));
  if (summary.termination_type != "FAILURE" && !is_finite) {
    summary.termination_type = "FAILURE";
    summary.message = std::string("Residual and Jacobian evaluation failed: the ") +
                      (has_cost ? "gradient" : "cost") + " is not finite.";
  }
  if (summary.termination_type == "FAILURE" || !std::isfinite(summary.initial_cost)) {
    summary.is_solution_usable = false;
  }
  if (!has_bounds) {
    Warn(WarningKind::kSteepEnd, FindSteepEnd(*record, function_tolerance), &summary.warnings);
  }
}

void FinishSolve(const AdjustmentProblem& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output) {
  SolveSummary& summary = output->summary;
  summary.warnings = std::move(warnings);
  const bool has_bounds = !layout.Bounds(problem).empty();
  JudgeEnd(has_bounds, options.function_tolerance, output);
  const auto warn = [&summary](WarningKind kind, std::string text) {
    Warn(kind, std::move(text), &summary.warnings);
  };
  if (summary.termination_type == "FAILURE" || !std::isfinite(summary.initial_cost)) {
    warn(WarningKind::kResidualNotFinite,
         FirstOverRanks(problem.division.communicator, FindOverflow(problem, options.cheirality)));
  }
  if (options.check_solution) {
    // A projected step misses the predicted decrease, like a step with a wrong Jacobian.
    if (!has_bounds) {
      warn(WarningKind::kSuspiciousSteps,
           problem.factors == nullptr
               ? WatchConvergence(output->iterations)
               : WatchConvergence(output->iterations,
                                  "test it with `bundle check` or bundle.check_factors"));
    }
    warn(
        WarningKind::kSuspiciousJacobian,
        FirstOverRanks(problem.division.communicator,
                       CheckSolution(problem, layout, states, output->points, options.cheirality)));
  }
  const bool is_rejected = RejectImpossibleSolution(problem, output);
  if (num_held > 0 && !is_rejected)
    JudgeLostObservations(problem, layout, options, num_held, output);
}

}  // namespace bundle
