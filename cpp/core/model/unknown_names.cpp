#include "core/model/unknown_names.h"

#include "core/cameras/camera_model.h"

namespace bundle {

std::vector<UnknownName> NameUnknowns(const AdjustmentProblem& problem,
                                      const ParameterLayout& layout) {
  std::vector<UnknownName> names(layout.state_size());
  constexpr int kShared = -1;  // marks a block of numbers that cameras share
  std::vector<UnknownName> owner(layout.blocks().size(), {kShared, 0, 0});
  const auto own = [&owner](int block, UnknownName::Kind kind, int index) {
    if (block >= 0) owner[block] = {kind, index, 0};
  };
  for (int c = 0; c < problem.num_cameras; ++c)
    own(layout.camera_block(c), UnknownName::kCamera, c);
  for (int c = 0; c < problem.num_cameras; ++c)
    own(layout.readout_block(c), UnknownName::kReadout, c);
  for (int i = 0; i < problem.num_images; ++i) own(layout.pose_block(i), UnknownName::kImage, i);
  for (const int p : layout.kept_points()) own(layout.kept_block(p), UnknownName::kPoint, p);
  for (int f = 0; f < problem.num_frames; ++f) {
    own(layout.pose_block(PoseOfFrame(problem, f)), UnknownName::kFrame, f);
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    own(layout.pose_block(PoseOfSensor(problem, s)), UnknownName::kSensor, s);
  }
  for (size_t b = 0; b < owner.size(); ++b) {
    const CameraBlock& block = layout.blocks()[b];
    if (owner[b].kind == kShared) continue;
    for (int k = 0; k < block.size; ++k) {
      UnknownName& name = names[block.offset + k];
      name = owner[b];
      const int column = block.columns[k];
      if (column < kPoseSize) {
        name.coordinate = column;
      } else if (column >= kFirstTwist) {
        name = {UnknownName::kTwist, name.index, column - kFirstTwist};
      } else {
        if (name.kind == UnknownName::kImage) {
          name = {UnknownName::kCamera, problem.image_camera[name.index], 0};
        }
        name.coordinate = column - kPoseSize;
      }
    }
  }
  // A number that several cameras share has the name of the first of these cameras.
  for (int c = problem.num_cameras - 1; c >= 0; --c) {
    for (const TiedParameter& tied : layout.tied(c)) {
      const CameraBlock& block = layout.blocks()[tied.block];
      if (owner[tied.block].kind != kShared) continue;
      names[block.offset + tied.entry] = {UnknownName::kCamera, c, tied.column - kPoseSize};
    }
  }
  return names;
}

std::string Words(const AdjustmentProblem& problem, const UnknownName& name) {
  if (name.kind == UnknownName::kCamera) {
    const CameraModel* const model = problem.camera_models[name.index];
    return std::string(model->params[name.coordinate].name) + " of camera " +
           std::to_string(problem.camera_ids[name.index]);
  }
  if (name.kind == UnknownName::kReadout) {
    return "readout of camera " + std::to_string(problem.camera_ids[name.index]);
  }
  if (name.kind == UnknownName::kPoint) {
    return std::string(1, "xyz"[name.coordinate]) + " of point " +
           std::to_string(problem.point_ids[name.index]);
  }
  if (name.kind == UnknownName::kTwist) {
    return std::string("twist ") + (name.coordinate < 3 ? "w" : "v") + "xyz"[name.coordinate % 3] +
           " of image " + std::to_string(problem.image_ids[name.index]);
  }
  const std::string part = name.coordinate < 3 ? "rotation " : "translation ";
  std::string whose = "image " + std::to_string(problem.image_ids[name.index]);
  if (name.kind == UnknownName::kFrame) {
    whose = "frame " + std::to_string(problem.frame_ids[name.index]);
  } else if (name.kind == UnknownName::kSensor) {
    whose = "the sensor of camera " + std::to_string(problem.sensor_camera_ids[name.index]);
  }
  return part + "xyz"[name.coordinate % 3] + " of " + whose;
}

}  // namespace bundle
