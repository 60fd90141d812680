#include "core/model/scene_frame.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <sstream>

#include "core/factors/loss.h"
#include "core/geometry/rotation.h"
#include "core/problem/reprojection_errors.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

double Median(std::vector<double>* values) {
  if (values->empty()) return 0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

/// Trimmed mean as in COLMAP's Reconstruction::Normalize. Uses all values if there are three or
/// fewer.
double TrimmedMean(std::vector<double>* values) {
  const auto last = static_cast<double>(values->size() - 1);
  const bool few = values->size() <= 3;
  std::sort(values->begin(), values->end());
  const auto begin = values->begin() + static_cast<std::ptrdiff_t>(few ? 0 : 0.1 * last);
  const auto end = values->begin() + static_cast<std::ptrdiff_t>(few ? last : 0.9 * last) + 1;
  return std::accumulate(begin, end, 0.0) / static_cast<double>(end - begin);
}

/// std::hypot is slow; it is used only for numbers whose squares would leave the range of doubles.
double Distance(const double* a, const double* b) {
  const double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  const double squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
  return squared > 1e-280 && squared < 1e280 ? std::sqrt(squared) : std::hypot(d[0], d[1], d[2]);
}

/// out = t + sign R c of a pose.
void MoveTranslation(const double* pose, const double* center, double sign, double* out) {
  double rotation[9], moved[3];
  QuaternionToRotation(pose, rotation);
  MatrixVector3(rotation, center, moved);
  for (int j = 0; j < 3; ++j) out[j] = pose[4 + j] + sign * moved[j];
}

/// Squared error of each observation, in pixels; NaN if it does not count.
LargeVector<double> SquaredErrors(const AdjustmentProblem& problem, const SolveOptions& options) {
  LargeVector<double> errors(problem.num_observations);
  LargeVector<uint8_t> behind(problem.num_observations);
  ComputeReprojectionErrors(problem, options.num_threads, options.cheirality, errors.data(),
                            behind.data());
  for (size_t i = 0; i < errors.size(); ++i) {
    const bool counts = !behind[i] || options.cheirality == Cheirality::kAlgebraic;
    errors[i] = counts ? errors[i] * errors[i] : std::nan("");
  }
  return errors;
}

}  // namespace

SceneFrame::SceneFrame(const AdjustmentProblem& problem) {
  const int64_t num_points =
      SumOverRanks(problem.division.communicator, int64_t{problem.num_points});
  if (problem.num_images == 0 || num_points == 0) return;
  std::vector<double> centers[3], distances;
  for (int64_t i = 0; i < problem.num_images; ++i) {
    const double* const pose = problem.cam_from_world + 7 * i;
    double rotation[9], backwards[3];
    QuaternionToRotation(pose, rotation);
    VectorMatrix3(pose + 4, rotation, backwards);
    for (int j = 0; j < 3; ++j) centers[j].push_back(-backwards[j]);
  }
  for (int j = 0; j < 3; ++j) center[j] = Median(&centers[j]);
  constexpr int64_t kSample = 4096;
  const int64_t stride = std::max<int64_t>(1, num_points / kSample);
  for (int64_t p = 0; p < problem.num_points; ++p) {
    const double distance = DistanceTo(problem.points + 3 * p);
    reach = std::max(reach, distance);
    if (p % stride == 0) distances.push_back(distance);
  }
  reach = MaxOverRanks(problem.division.communicator, reach);
  distances = ConcatenateOverRanks(problem.division.communicator, distances);
  size = Median(&distances);
  std::copy_n(center, 3, origin);
  if (!IsFarFromOrigin()) return;
  double mean[3];
  for (int j = 0; j < 3; ++j) mean[j] = TrimmedMean(&centers[j]);
  if (DistanceTo(mean) < kFarOrigin * size) std::copy_n(mean, 3, origin);
}

double SceneFrame::DistanceTo(const double* point) const { return Distance(point, center); }

bool SceneFrame::IsFarFromOrigin() const {
  constexpr double kOrigin[3] = {};
  const double distance = DistanceTo(kOrigin);
  return size > 0 && std::isfinite(distance) && distance > kFarOrigin * size;
}

CenteredProblem::CenteredProblem(const AdjustmentProblem& problem, const SceneFrame& frame)
    : problem_(problem), frame_(frame), centered_(problem) {
  if (!frame.IsFarFromOrigin()) return;
  const auto move = [&](const double* poses, int count, std::vector<double>* moved) {
    moved->assign(poses, poses + 7 * static_cast<int64_t>(count));
    for (size_t i = 0; i < moved->size(); i += 7) {
      MoveTranslation(poses + i, frame.origin, 1, &(*moved)[i + 4]);
    }
  };
  move(problem.cam_from_world, problem.num_images, &cam_from_world_);
  if (problem.num_frames > 0) move(problem.rig_from_world, problem.num_frames, &rig_from_world_);
  points_.assign(problem.points, problem.points + 3 * static_cast<int64_t>(problem.num_points));
  for (size_t k = 0; k < points_.size(); ++k) points_[k] -= frame.origin[k % 3];
  centered_.cam_from_world = cam_from_world_.data();
  if (problem.num_frames > 0) centered_.rig_from_world = rig_from_world_.data();
  centered_.points = points_.data();
  for (int j = 0; j < 3; ++j) centered_.origin[j] = problem.origin[j] + frame.origin[j];
}

void CenteredProblem::MoveBack(SolveOutput* output) const {
  if (!is_moved()) return;
  const auto move_back = [&](const std::vector<double>& start, const double* given,
                             std::vector<double>* poses) {
    for (size_t i = 0; i < start.size(); i += 7) {
      double* const pose = &(*poses)[i];
      if (std::equal(pose, pose + 7, &start[i])) {
        std::copy_n(given + i, 7, pose);
      } else {
        MoveTranslation(pose, frame_.origin, -1, pose + 4);
      }
    }
  };
  move_back(cam_from_world_, problem_.cam_from_world, &output->cam_from_world);
  move_back(rig_from_world_, problem_.rig_from_world, &output->rig_from_world);
  for (size_t k = 0; k < points_.size(); k += 3) {
    double* const point = &output->points[k];
    if (std::equal(point, point + 3, &points_[k])) {
      std::copy_n(problem_.points + k, 3, point);
    } else {
      for (int j = 0; j < 3; ++j) point[j] += frame_.origin[j];
    }
  }
  output->summary.origin.assign(frame_.origin, frame_.origin + 3);
  constexpr double kOrigin[3] = {};
  std::ostringstream sentence;
  sentence << "The scene lies " << frame_.DistanceTo(kOrigin) * frame_.unit
           << " units from the origin and measures " << frame_.size * frame_.unit
           << ": it was solved about its centre.";
  Warn(WarningKind::kFarOrigin, sentence.str(), &output->summary.warnings);
}

FarPoints FindFarPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                        const SceneFrame& frame) {
  FarPoints result;
  if (!(frame.size > 0) || !(frame.reach > kFarPoint * frame.size)) return result;
  const std::vector<double> cameras = layout.InitialState(problem);
  double near_squared = SquaredNorm(cameras.data(), static_cast<int>(cameras.size()));
  double far_squared = 0;
  Communicator* const communicator = problem.division.communicator;
  if (!IsFirst(communicator)) near_squared = 0;
  std::vector<uint8_t> is_far(problem.num_points), is_used(problem.num_points);
  for (int p = 0; p < problem.num_points; ++p) {
    const double* const point = problem.points + 3 * static_cast<int64_t>(p);
    is_far[p] = frame.DistanceTo(point) > kFarPoint * frame.size ? 1 : 0;
    if (layout.point_is_free(p)) (is_far[p] ? far_squared : near_squared) += SquaredNorm(point, 3);
  }
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    if (!layout.IsRefined(problem, i)) continue;
    const int point = problem.observation_point[i];
    is_used[point] = 1;
    (is_far[point] ? result.observations : result.others).push_back(i);
  }
  result.num_observations =
      SumOverRanks(communicator, static_cast<int64_t>(result.observations.size()));
  if (result.num_observations == 0) return result;
  far_squared = SumOverRanks(communicator, far_squared);
  near_squared = SumOverRanks(communicator, near_squared);
  if (far_squared > 0) result.norm_without = 1 / std::sqrt(1 + far_squared / near_squared);
  int64_t count = 0, num_free = 0;
  double farthest = 0;
  int worst = -1;
  for (int p = 0; p < problem.num_points; ++p) {
    if (!is_far[p] || !is_used[p]) continue;
    ++count;
    num_free += layout.point_is_free(p) ? 1 : 0;
    const double distance = frame.DistanceTo(problem.points + 3 * static_cast<int64_t>(p));
    if (distance > farthest) farthest = distance, worst = p;
  }
  count = SumOverRanks(communicator, count);
  num_free = SumOverRanks(communicator, num_free);
  const double farthest_of_all = MaxOverRanks(communicator, farthest);
  const bool is_here = worst >= 0 && farthest == farthest_of_all;
  const std::string worst_id = FirstOverRanks(
      communicator, is_here ? std::to_string(problem.point_ids[worst]) : std::string());
  std::ostringstream sentence;
  sentence << "Points more than " << kFarPoint << " times the size of the scene ("
           << frame.size * frame.unit << ") away from its centre: " << count;
  if (num_free < count) sentence << " (" << count - num_free << " held)";
  sentence << ", the farthest is point " << worst_id << " (" << farthest_of_all * frame.unit
           << "). ";
  if (num_free > 0) sentence << "The parameter tolerance leaves them out; a few ";
  if (num_free == 0) sentence << "A few ";
  sentence << "wrong points can prevent the convergence of all others: remove wrong points.";
  result.warning = sentence.str();
  return result;
}

void JudgeFarPoints(const AdjustmentProblem& problem, const FarPoints& far,
                    const SolveOptions& options, SolveOutput* output) {
  SolveSummary& summary = output->summary;
  if (far.num_observations == 0 || !summary.is_solution_usable || options.max_num_iterations == 0) {
    return;
  }
  AdjustmentProblem refined = problem;
  refined.cam_from_world = output->cam_from_world.data();
  refined.camera_params = output->camera_params.data();
  refined.points = output->points.data();
  output->PutShutters(&refined);
  const LargeVector<double> before = SquaredErrors(problem, options);
  const LargeVector<double> after = SquaredErrors(refined, options);
  double rho[3];
  double weighted = 0;
  for (const int64_t i : far.observations) {
    if (std::isnan(after[i])) continue;
    ValueOfLoss(options.loss, options.loss_scale, after[i], rho);
    weighted += rho[1] * after[i];
  }
  const auto cost = [&](const std::vector<int64_t>& observations, const LargeVector<double>& at) {
    double sum = 0;
    for (const int64_t i : observations) {
      if (std::isnan(before[i]) || std::isnan(after[i])) continue;
      ValueOfLoss(options.loss, options.loss_scale, at[i], rho);
      sum += 0.5 * rho[0];
    }
    return SumOverRanks(problem.division.communicator, sum);
  };
  weighted = SumOverRanks(problem.division.communicator, weighted);
  const double far_cost = cost(far.observations, after);
  const double near_cost = cost(far.others, after), near_cost_before = cost(far.others, before);
  const double bound = options.loss == LossType::kTrivial ? 1 : std::max(1.0, options.loss_scale);
  const auto count = static_cast<double>(far.num_observations);
  const bool pulls = std::sqrt(weighted / count) > kFarPull * bound;
  if (!pulls || !(far_cost > near_cost || near_cost > kMaxNearRise * near_cost_before)) return;
  summary.is_solution_usable = false;
  std::ostringstream sentence;
  sentence << "The solution is not usable: it mainly fits the points far outside the scene, "
           << "whose observations cost " << far_cost << "; all others cost " << near_cost
           << " at the end and " << near_cost_before << " at the start.";
  Warn(WarningKind::kFarPointsDominate, sentence.str(), &summary.warnings);
}

}  // namespace bundle
