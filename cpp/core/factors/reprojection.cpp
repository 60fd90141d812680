#include "core/factors/reprojection.h"

namespace bundle {

bool EvaluateReprojection(const CameraModel& model, const PoseState& pose, const double* params,
                          const double* point, const double* measurement, Cheirality cheirality,
                          double* residual, ReprojectionJacobian* jacobian,
                          const ImageShutter* shutter) {
  double rotated[3], camera_point[3], xy[2], d_point[6];
  MatrixVector3(pose.rotation, point, rotated);
  for (int i = 0; i < 3; ++i) camera_point[i] = rotated[i] + pose.translation[i];
  const bool linearize = jacobian != nullptr;
  double* const by_point = linearize ? d_point : nullptr;
  double* const by_params = linearize ? jacobian->params : nullptr;
  Projection projection;
  if (shutter == nullptr) {
    projection = model.project(params, camera_point, xy, by_point, by_params);
  } else {
    const auto project = [&](const double* at, double* r, double* d_at, double* d_params) {
      const Projection found = model.project(params, at, xy, d_at, d_params);
      if (!Counts(found, cheirality)) return Projection::kUndefined;
      model.difference(params, xy, measurement, r, d_params);
      return found;
    };
    projection = ProjectByRow(project, model.num_params, *shutter, camera_point, measurement,
                              residual, by_point, by_params, linearize ? jacobian->twist : nullptr);
  }
  if (!Counts(projection, cheirality)) {
    residual[0] = residual[1] = 0;
    if (linearize) *jacobian = {};
    return false;
  }
  if (shutter == nullptr) model.difference(params, xy, measurement, residual, by_params);
  if (!linearize) return true;
  for (int row = 0; row < 2; ++row) {
    const double* a = d_point + 3 * row;
    double* d_pose = jacobian->pose + kPoseSize * row;
    double torque[3];
    Cross3(rotated, a, torque);
    VectorMatrix3(torque, pose.left_jacobian, d_pose);
    for (int i = 0; i < 3; ++i) d_pose[3 + i] = a[i];
    VectorMatrix3(a, pose.rotation, jacobian->point + 3 * row);
  }
  return true;
}

}  // namespace bundle
