#include "core/model/parameter_layout.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/model/problem_factors.h"

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

/// What factors touch may be seen by no observation.
void FreeTouched(const ProblemView& problem, const SolveOptions& options, FreeParameters* free) {
  for (const ProblemVariable& variable : problem.factors->variables) {
    switch (variable.kind) {
      case ProblemVariable::Kind::kImage:
        if (options.refine_poses) free->pose[variable.index] = FreeParameters::kWholePose;
        break;
      case ProblemVariable::Kind::kCamera:
        if (problem.camera_models[variable.index] == nullptr) break;
        free->camera[variable.index] =
            FreeCameraParameters(*problem.camera_models[variable.index], options);
        break;
      case ProblemVariable::Kind::kPoint:
        if (options.refine_points) free->point[variable.index] = 1;
        break;
    }
  }
}

void HoldBetweenEqualBounds(const ProblemView& problem, FreeParameters* free) {
  if (problem.camera_lower == nullptr) return;
  const int num_params = std::min(problem.camera_params_stride, kMaxCameraParams);
  for (int c = 0; c < problem.num_cameras; ++c) {
    const int64_t first = static_cast<int64_t>(c) * problem.camera_params_stride;
    for (int j = 0; j < num_params; ++j) {
      const bool equal = problem.camera_lower[first + j] == problem.camera_upper[first + j];
      if (equal) free->camera[c] &= ~(1u << j);
    }
  }
}

void HoldParts(const ProblemView& problem, FreeParameters* free) {
  constexpr uint8_t kRotation = 0b000111;
  for (int c = 0; problem.held_camera_params != nullptr && c < problem.num_cameras; ++c) {
    free->camera[c] &= ~problem.held_camera_params[c];
  }
  for (int i = 0; problem.held_pose_parts != nullptr && i < problem.num_images; ++i) {
    const uint8_t parts = problem.held_pose_parts[i];
    if (parts == (kHeldRotation | kHeldPosition)) free->pose[i] = 0;
    if (parts == kHeldRotation) free->pose[i] = static_cast<uint8_t>(free->pose[i] & ~kRotation);
  }
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
  if (problem.factors != nullptr) FreeTouched(problem, options, &free);
  HoldBetweenEqualBounds(problem, &free);
  HoldParts(problem, &free);
  ForEachIndex("camera", options.fixed_camera_ids, problem.camera_ids, problem.num_cameras,
               [&](int index) { free.camera[index] = 0; });
  ForEachIndex("image", options.fixed_image_ids, problem.image_ids, problem.num_images,
               [&](int index) { free.pose[index] = 0; });
  ForEachIndex("point", options.fixed_point_ids, problem.point_ids, problem.num_points,
               [&](int index) { free.point[index] = 0; });
  return free;
}

namespace {

std::vector<uint8_t> FindObservedImages(const ProblemView& problem) {
  std::vector<uint8_t> observed(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) observed[problem.observation_image[i]] = 1;
  return observed;
}

}  // namespace

ParameterLayout::ParameterLayout(const ProblemView& problem, FreeParameters free)
    : free_(std::move(free)),
      image_block_(problem.num_images, -1),
      camera_block_(problem.num_cameras, -1),
      params_block_(problem.num_cameras, -1) {
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::vector<int> users(problem.num_cameras);  // observed images of each camera
  for (int i = 0; i < problem.num_images; ++i) users[problem.image_camera[i]] += observed[i];
  for (int i = 0; i < problem.num_images; ++i) {
    const int camera = problem.image_camera[i];
    const bool own_camera = observed[i] && users[camera] == 1;
    image_block_[i] = AddBlock(free_.pose[i], own_camera ? free_.camera[camera] : 0);
    if (own_camera && free_.camera[camera] != 0) params_block_[camera] = image_block_[i];
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    if (users[c] != 1) params_block_[c] = camera_block_[c] = AddBlock(0, free_.camera[c]);
  }
  for (int i = 0; i < problem.num_images; ++i) {
    has_shared_intrinsics_ |= image_block_[i] >= 0 && camera_block_[problem.image_camera[i]] >= 0;
  }
  num_free_points_ = static_cast<int>(std::count(free_.point.begin(), free_.point.end(), 1));
}

int ParameterLayout::AddBlock(uint8_t pose_bits, uint32_t camera_bits) {
  CameraBlock block;
  block.offset = state_size_;
  const uint32_t bits = pose_bits | camera_bits << kPoseSize;
  for (int8_t j = 0; j < kPoseSize + kMaxCameraParams; ++j) {
    if (bits >> j & 1u) block.columns[block.size++] = j;
  }
  if (block.size == 0) return -1;
  state_size_ += block.size;
  blocks_.push_back(block);
  return static_cast<int>(blocks_.size()) - 1;
}

void ParameterLayout::Reorder(const std::vector<int>& order) {
  std::vector<CameraBlock> blocks;
  std::vector<int> position(order.size());
  int offset = 0;
  for (const int block : order) {
    position[block] = static_cast<int>(blocks.size());
    blocks.push_back(blocks_[block]);
    blocks.back().offset = offset;
    offset += blocks.back().size;
  }
  blocks_ = std::move(blocks);
  for (std::vector<int>* index : {&image_block_, &camera_block_, &params_block_}) {
    for (int& block : *index) block = block < 0 ? -1 : position[block];
  }
}

bool ParameterLayout::IsRefined(const ProblemView& problem, int64_t observation) const {
  const int image = problem.observation_image[observation];
  return point_is_free(problem.observation_point[observation]) || image_block_[image] >= 0 ||
         camera_block_[problem.image_camera[image]] >= 0;
}

template <typename Pose>
std::vector<double> ParameterLayout::Gather(const ProblemView& problem, const Pose& pose,
                                            const double* camera_params) const {
  std::vector<double> state(state_size_);
  const auto fill = [&](int index, int image, int camera) {
    if (index < 0) return;
    const CameraBlock& block = blocks_[index];
    const double* const params =
        camera_params + static_cast<int64_t>(camera) * problem.camera_params_stride;
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      state[block.offset + k] =
          column < kPoseSize ? pose(image, column) : params[column - kPoseSize];
    }
  };
  for (int i = 0; i < problem.num_images; ++i) fill(image_block_[i], i, problem.image_camera[i]);
  for (int c = 0; c < problem.num_cameras; ++c) fill(camera_block_[c], -1, c);
  return state;
}

std::vector<double> ParameterLayout::InitialState(const ProblemView& problem) const {
  const auto pose = [&](int image, int column) {
    const double* const translation = problem.cam_from_world + 7 * static_cast<int64_t>(image) + 4;
    return column < 3 ? 0.0 : translation[column - 3];
  };
  return Gather(problem, pose, problem.camera_params);
}

StateBounds ParameterLayout::Bounds(const ProblemView& problem) const {
  if (problem.camera_lower == nullptr) return {};
  constexpr double kNone = std::numeric_limits<double>::infinity();
  StateBounds bounds;
  bounds.lower = Gather(problem, [](int, int) { return -kNone; }, problem.camera_lower);
  bounds.upper = Gather(problem, [](int, int) { return kNone; }, problem.camera_upper);
  const auto is_none = [](double bound) { return std::isinf(bound); };
  const bool has_none = std::all_of(bounds.lower.begin(), bounds.lower.end(), is_none) &&
                        std::all_of(bounds.upper.begin(), bounds.upper.end(), is_none);
  return has_none ? StateBounds() : bounds;
}

void ParameterLayout::Scatter(const ProblemView& problem, const double* state, double* poses,
                              double* camera_params) const {
  const auto write = [&](int index, double* pose, double* params) {
    if (index < 0) return;
    const CameraBlock& block = blocks_[index];
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      (column < kPoseSize ? pose[column] : params[column - kPoseSize]) = state[block.offset + k];
    }
  };
  const auto params_of = [&](int camera) {
    return camera_params + static_cast<int64_t>(camera) * problem.camera_params_stride;
  };
  for (int i = 0; i < problem.num_images; ++i) {
    write(image_block_[i], poses + static_cast<int64_t>(i) * kPoseSize,
          params_of(problem.image_camera[i]));
  }
  for (int c = 0; c < problem.num_cameras; ++c) write(camera_block_[c], nullptr, params_of(c));
}

ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals) {
  ProblemShape shape;
  shape.num_residuals = num_residuals;
  shape.num_free_points = layout.num_free_points();
  shape.num_camera_columns = layout.state_size();
  shape.num_camera_blocks = static_cast<int>(layout.blocks().size());
  return shape;
}

CameraStates::CameraStates(const ProblemView& problem, const ParameterLayout& layout)
    : problem_(problem),
      layout_(layout),
      stride_(problem.camera_params_stride),
      charts_(static_cast<size_t>(problem.num_images) * kPoseSize),
      poses_(problem.num_images) {
  Reset();
}

void CameraStates::Reset() {
  camera_params_.assign(
      problem_.camera_params,
      problem_.camera_params + static_cast<std::ptrdiff_t>(problem_.num_cameras) * stride_);
  std::fill(charts_.begin(), charts_.end(), 0.0);
  auto anchors = std::make_shared<PoseAnchors>(problem_.num_images);
  for (int64_t i = 0; i < problem_.num_images; ++i) {
    const double* pose = problem_.cam_from_world + 7 * i;
    PoseAnchor& anchor = (*anchors)[i];
    std::fill_n(anchor.w, 3, 0.0);
    std::copy_n(pose, 4, anchor.quaternion);
    QuaternionToRotation(pose, anchor.rotation);
    std::copy(pose + 4, pose + 7, &charts_[kPoseSize * i + 3]);
  }
  anchors_ = std::move(anchors);
  Update(layout_.InitialState(problem_).data());
}

void CameraStates::Update(const double* state) {
  layout_.Scatter(problem_, state, charts_.data(), camera_params_.data());
  for (int i = 0; i < problem_.num_images; ++i) Expand(i);
}

void CameraStates::Expand(int image) {
  double chart[kPoseSize];
  Chart(image, chart);
  ExpandPose(anchor_rotation(image), chart, &poses_[image]);
}

bool CameraStates::MoveAnchors() {
  std::shared_ptr<PoseAnchors> moved;
  for (int i = 0; i < problem_.num_images; ++i) {
    double v[kPoseSize], pose[7];
    Chart(i, v);
    if (!(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > kMaxChartAngle * kMaxChartAngle)) continue;
    if (moved == nullptr) moved = std::make_shared<PoseAnchors>(*anchors_);
    CamFromWorld(i, pose);
    PoseAnchor& anchor = (*moved)[i];
    std::copy_n(&charts_[kPoseSize * int64_t{i}], 3, anchor.w);
    std::copy_n(pose, 4, anchor.quaternion);
    QuaternionToRotation(pose, anchor.rotation);
  }
  if (moved == nullptr) return false;
  anchors_ = std::move(moved);
  for (int i = 0; i < problem_.num_images; ++i) Expand(i);
  return true;
}

void CameraStates::Chart(int image, double* chart) const {
  std::copy_n(&charts_[kPoseSize * int64_t{image}], kPoseSize, chart);
  for (int j = 0; j < 3; ++j) chart[j] -= (*anchors_)[image].w[j];
}

void CameraStates::CamFromWorld(int image, double pose[7]) const {
  double chart[kPoseSize];
  Chart(image, chart);
  std::copy_n((*anchors_)[image].quaternion, 4, pose);
  std::copy_n(chart + 3, 3, pose + 4);
  if (chart[0] == 0 && chart[1] == 0 && chart[2] == 0) return;
  double increment[4], rotated[4];
  ExpQuaternion(chart, increment);
  QuaternionProduct(increment, pose, rotated);
  NormalizeQuaternion(rotated);
  std::copy_n(rotated, 4, pose);
}

std::vector<double> CameraStates::CamFromWorld() const {
  std::vector<double> cam_from_world(7 * poses_.size());
  for (size_t i = 0; i < poses_.size(); ++i) {
    CamFromWorld(static_cast<int>(i), &cam_from_world[7 * i]);
  }
  return cam_from_world;
}

}  // namespace bundle
