#include "core/problem/linearize.h"

#include <algorithm>
#include <vector>

#include "core/cameras/registry.h"
#include "core/problem/reprojection_errors.h"

namespace bundle {
namespace {

PoseState PoseAt(const double* cam_from_world, const double* w) {
  double start[9], chart[6];
  QuaternionToRotation(cam_from_world, start);
  std::copy_n(w, 3, chart);
  std::copy_n(cam_from_world + 4, 3, chart + 3);
  PoseState pose;
  ExpandPose(start, chart, &pose);
  return pose;
}

template <typename Model>
void LinearizeOne(const ProblemView& problem, const PoseState& pose, int64_t i,
                  Cheirality cheirality, const Linearization& out) {
  constexpr int kParams = kNumParams<Model>;
  const int camera = problem.image_camera[problem.observation_image[i]];
  const int stride = problem.camera_params_stride;
  ReprojectionJacobian<kParams> jacobian;
  EvaluateReprojection<Model>(
      pose, problem.ParamsOf(camera), problem.points + 3 * int64_t{problem.observation_point[i]},
      problem.observation_xy + 2 * i, cheirality, out.residual + 2 * i, &jacobian);
  std::copy_n(jacobian.pose, 12, out.d_pose + 12 * i);
  std::copy_n(jacobian.point, 6, out.d_point + 6 * i);
  double* d_params = out.d_params + 2 * stride * i;
  std::fill_n(d_params, 2 * stride, 0.0);
  for (int row = 0; row < 2; ++row) {
    std::copy_n(jacobian.params + kParams * row, kParams, d_params + stride * row);
  }
}

}  // namespace

void Linearize(const ProblemView& problem, const double* rotation_offsets, Cheirality cheirality,
               const Linearization& out) {
  CheckCameraModelsKnown(problem);
  std::vector<PoseState> poses;
  for (int64_t i = 0; i < problem.num_images; ++i) {
    poses.push_back(PoseAt(problem.cam_from_world + 7 * i, rotation_offsets + 3 * i));
  }
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i];
    VisitCameraModel(*problem.camera_models[problem.image_camera[image]], [&](auto model) {
      LinearizeOne<decltype(model)>(problem, poses[image], i, cheirality, out);
    });
  }
}

}  // namespace bundle
