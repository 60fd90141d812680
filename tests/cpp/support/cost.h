#pragma once

/// The cost of a problem, in extended precision and by a loop that shares only the lens formulas
/// with the code under test.

#include <cmath>
#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "support/scene.h"

namespace bundle::testing {

/// rho(s) of each loss with scale a in pixels.
inline long double Rho(LossType loss, long double a, long double s) {
  const long double b = a * a;
  switch (loss) {
    case LossType::kTrivial:
      return s;
    case LossType::kHuber:
      return s <= b ? s : 2 * a * std::sqrt(s) - b;
    case LossType::kSoftL1:
      return 2 * b * (std::sqrt(1 + s / b) - 1);
    case LossType::kCauchy:
      return b * std::log(1 + s / b);
    case LossType::kArctan:
      return b * std::atan(s / b);
    case LossType::kTukey:
      return s <= b ? b / 3 * (1 - std::pow(1 - s / b, 3.0L)) : b / 3;
  }
  return s;
}

/// 1/2 sum rho(||r||^2) over observations [begin, end).
inline long double ProblemCost(const AdjustmentProblem& problem, const SolveOptions& options,
                               int64_t begin, int64_t end) {
  long double cost = 0;
  for (int64_t i = begin; i < end; ++i) {
    const int image = problem.observation_image[i], camera = problem.image_camera[image];
    const double* pose = problem.cam_from_world + 7 * static_cast<int64_t>(image);
    const double* point = problem.points + 3 * static_cast<int64_t>(problem.observation_point[i]);
    double rotation[9], in_camera[3], xy[2], residual[2];
    QuaternionToRotation(pose, rotation);
    MatrixVector3(rotation, point, in_camera);
    for (int j = 0; j < 3; ++j) in_camera[j] += pose[4 + j];
    const CameraModel& model = *problem.camera_models[camera];
    const Projection projection =
        model.project(problem.ParamsOf(camera), in_camera, xy, nullptr, nullptr);
    if (!Counts(projection, options.cheirality)) continue;
    model.difference(problem.ParamsOf(camera), xy, problem.observation_xy + 2 * i, residual,
                     nullptr);
    const long double x = residual[0], y = residual[1];
    cost += Rho(options.loss, options.loss_scale, x * x + y * y) / 2;
  }
  return cost;
}

inline long double ProblemCost(const AdjustmentProblem& problem, const SolveOptions& options) {
  return ProblemCost(problem, options, 0, problem.num_observations);
}

/// The cost of what a solve of `scene` gave back.
inline long double SolvedCost(const Scene& scene, const SolveOutput& output,
                              const SolveOptions& options, int64_t begin, int64_t end) {
  AdjustmentProblem solved = scene.View();
  solved.cam_from_world = output.cam_from_world.data();
  solved.camera_params = output.camera_params.data();
  solved.points = output.points.data();
  return ProblemCost(solved, options, begin, end);
}

inline long double SolvedCost(const Scene& scene, const SolveOutput& output,
                              const SolveOptions& options) {
  return SolvedCost(scene, output, options, 0, scene.num_observations());
}

}  // namespace bundle::testing
