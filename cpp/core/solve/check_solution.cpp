#include "core/solve/check_solution.h"

#include <algorithm>
#include <functional>

#include "core/cameras/registry.h"
#include "core/solve/observation_sample.h"

namespace bundle {
namespace {

// Checking an observation costs 3 to 5 microseconds, about what a step of a solve spends on it: a
// hundredth of them is a thousandth of a solve.
constexpr int64_t kSmallestSample = 32;
constexpr int64_t kLargestSample = 256;
constexpr int64_t kObservationsPerSample = 100;

}  // namespace

SolutionUnderCheck::SolutionUnderCheck(const ProblemView& problem, const ParameterLayout& layout,
                                       const CameraStates& states,
                                       const std::vector<double>& points, Cheirality cheirality)
    : problem_(problem),
      layout_(layout),
      states_(states),
      points_(points),
      cheirality_(cheirality) {}

uint32_t SolutionUnderCheck::FreeColumns(int64_t observation) const {
  const int image = problem_.observation_image[observation];
  const int camera = problem_.image_camera[image];
  uint32_t free = 0;
  for (const int index : {layout_.image_block(image), layout_.camera_block(camera)}) {
    if (index < 0) continue;
    const CameraSideBlock& block = layout_.blocks()[index];
    for (int k = 0; k < block.size; ++k) free |= 1u << block.columns[k];
  }
  if (layout_.point_is_free(problem_.observation_point[observation])) {
    free |= 7u << (kPoseSize + problem_.camera_models[camera]->num_params);
  }
  return free;
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
    at.free = FreeColumns(observation);
    if (at.free == 0) continue;
    double* x = std::copy_n(states_.chart(image), kPoseSize, at.x);
    x = std::copy_n(states_.params(camera), at.model->num_params, x);
    std::copy_n(&points_[3 * int64_t{problem_.observation_point[observation]}], 3, x);
    sample.push_back(at);
  }
  return sample;
}

bool SolutionUnderCheck::operator()(int64_t observation, const double* x, double* residual,
                                    double* jacobian) const {
  const int image = problem_.observation_image[observation];
  const double* measurement = problem_.observation_xy + 2 * observation;
  PoseState pose;
  ExpandPose(states_.start_rotation(image), x, &pose);
  bool counts = false;
  VisitCameraModel(*problem_.camera_models[problem_.image_camera[image]], [&](auto model) {
    using Model = decltype(model);
    constexpr int kParams = kNumParams<Model>;
    const double *params = x + kPoseSize, *point = params + kParams;
    if (jacobian == nullptr) {
      counts = EvaluateReprojection<Model, kParams>(pose, params, point, measurement, cheirality_,
                                                    residual, nullptr);
      return;
    }
    ReprojectionJacobian<kParams> parts;
    counts = EvaluateReprojection<Model>(pose, params, point, measurement, cheirality_, residual,
                                         &parts);
    for (int row = 0; row < 2; ++row) {
      jacobian = std::copy_n(parts.pose + kPoseSize * row, kPoseSize, jacobian);
      jacobian = std::copy_n(parts.params + kParams * row, kParams, jacobian);
      jacobian = std::copy_n(parts.point + 3 * row, 3, jacobian);
    }
  });
  return counts;
}

std::string CheckSolution(const ProblemView& problem, const ParameterLayout& layout,
                          const CameraStates& states, const std::vector<double>& points,
                          Cheirality cheirality) {
  const SolutionUnderCheck solution(problem, layout, states, points, cheirality);
  return SpotCheck(solution.Sample(), std::cref(solution));
}

}  // namespace bundle
