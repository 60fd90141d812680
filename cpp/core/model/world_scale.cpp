#include "core/model/world_scale.h"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>

#include "core/model/problem_factors.h"

namespace bundle {
namespace {

std::vector<double> ScalePoses(const double* poses, int count, double scale) {
  std::vector<double> scaled(poses, poses + 7 * static_cast<int64_t>(count));
  for (size_t i = 0; i < scaled.size(); ++i) {
    if (i % 7 >= 4) scaled[i] *= scale;
  }
  return scaled;
}

void MultiplyTranslations(double scale, std::vector<double>* poses) {
  *poses = ScalePoses(poses->data(), static_cast<int>(poses->size() / 7), scale);
}

std::vector<double> ScaleTwists(const double* twists, size_t size, double scale) {
  std::vector<double> scaled(twists, twists + size);
  for (size_t i = 0; i < size; ++i) scaled[i] *= i % kTwistSize >= 3 ? scale : 1;
  return scaled;
}

}  // namespace

ScaledProblem::ScaledProblem(const AdjustmentProblem& problem) : scaled_(problem), frame_(problem) {
  const double size = frame_.size;
  if (!(size > 0) || !std::isfinite(size) || (size > kSmallestWorld && size < kLargestWorld)) {
    return;
  }
  if (DependsOnPoses(problem)) {
    std::ostringstream sentence;
    sentence << "The size of the scene is " << size
             << " units, and priors or other factors fix this "
             << "unit. Steps and tolerances are designed for sizes from " << kSmallestWorld
             << " to " << kLargestWorld << "; the solve may end early. Choose another unit.";
    warning_ = sentence.str();
    return;
  }
  const double scale = std::ldexp(1.0, -std::ilogb(size));
  cam_from_world_ = ScalePoses(problem.cam_from_world, problem.num_images, scale);
  scaled_.cam_from_world = cam_from_world_.data();
  if (problem.num_frames > 0) {
    rig_from_world_ = ScalePoses(problem.rig_from_world, problem.num_frames, scale);
    scaled_.rig_from_world = rig_from_world_.data();
  }
  if (problem.num_sensors > 0) {
    sensor_from_rig_ = ScalePoses(problem.sensor_from_rig, problem.num_sensors, scale);
    scaled_.sensor_from_rig = sensor_from_rig_.data();
  }
  if (problem.twists != nullptr) {
    twists_ = ScaleTwists(problem.twists, size_t{kTwistSize} * problem.num_images, scale);
    scaled_.twists = twists_.data();
  }
  points_.assign(problem.points, problem.points + 3 * static_cast<int64_t>(problem.num_points));
  for (double& coordinate : points_) coordinate *= scale;
  scaled_.points = points_.data();
  frame_ = SceneFrame(scaled_);
  frame_.unit = 1 / scale;
}

void ScaledProblem::ScaleBack(SolveOutput* output) const {
  if (frame_.unit == 1) return;
  MultiplyTranslations(frame_.unit, &output->cam_from_world);
  MultiplyTranslations(frame_.unit, &output->rig_from_world);
  MultiplyTranslations(frame_.unit, &output->sensor_from_rig);
  output->twists = ScaleTwists(output->twists.data(), output->twists.size(), frame_.unit);
  for (double& coordinate : output->points) coordinate *= frame_.unit;
  for (double& coordinate : output->summary.origin) coordinate *= frame_.unit;
}

}  // namespace bundle
