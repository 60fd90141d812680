#include "core/solve/free_parameters.h"

#include <string>
#include <unordered_map>

#include "core/cameras/camera_model.h"
#include "core/error.h"

namespace bundle {
namespace {

/// Calls fix(index) for each id.
template <typename Fix>
void ForEachIndex(const char* what, const std::vector<int64_t>& wanted, const int64_t* ids,
                  int num_ids, const Fix& fix) {
  if (wanted.empty()) return;
  std::unordered_map<int64_t, int> index_of_id;
  for (int i = 0; i < num_ids; ++i) index_of_id.emplace(ids[i], i);
  for (const int64_t id : wanted) {
    const auto found = index_of_id.find(id);
    if (found == index_of_id.end()) {
      throw InputError(std::string("fixed_") + what + "_ids: expected ids in the problem, found " +
                       std::to_string(id));
    }
    fix(found->second);
  }
}

bool IsRefined(CameraParam::Kind kind, const SolveOptions& options) {
  switch (kind) {
    case CameraParam::kFocal:
      return options.refine_focal;
    case CameraParam::kPrincipalPoint:
      return options.refine_principal_point;
    case CameraParam::kExtra:
      return options.refine_extra;
    case CameraParam::kMetadata:
      return false;
  }
  return false;
}

uint32_t FreeCameraParameters(const CameraModel& model, const SolveOptions& options) {
  uint32_t free = 0;
  for (int j = 0; j < model.num_params; ++j) {
    if (IsRefined(model.params[j].kind, options)) free |= 1u << j;
  }
  return free;
}

}  // namespace

FreeParameters SelectFreeParameters(const ProblemView& problem, const SolveOptions& options) {
  FreeParameters free;
  free.pose.resize(problem.num_images);
  free.camera.resize(problem.num_cameras);
  free.point.resize(problem.num_points);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    if (options.refine_poses) {
      free.pose[problem.observation_image[i]] = FreeParameters::kWholePose;
    }
    if (options.refine_points) free.point[problem.observation_point[i]] = 1;
    const int camera = problem.image_camera[problem.observation_image[i]];
    if (free.camera[camera] == 0) {
      free.camera[camera] = FreeCameraParameters(*problem.camera_models[camera], options);
    }
  }
  ForEachIndex("camera", options.fixed_camera_ids, problem.camera_ids, problem.num_cameras,
               [&](int index) { free.camera[index] = 0; });
  ForEachIndex("image", options.fixed_image_ids, problem.image_ids, problem.num_images,
               [&](int index) { free.pose[index] = 0; });
  ForEachIndex("point", options.fixed_point_ids, problem.point_ids, problem.num_points,
               [&](int index) { free.point[index] = 0; });
  return free;
}

}  // namespace bundle
