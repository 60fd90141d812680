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
#include "core/model/coupled_blocks.h"
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

namespace {

/// Beyond this many blocks a count takes longer than what it decides is worth.
constexpr int kMaxBlocksToCount = 20000;

}  // namespace

double CountSchurDensity(const ProblemView& problem, const ParameterLayout& layout) {
  const auto n = static_cast<int64_t>(layout.blocks().size());
  if (n == 0 || n > kMaxBlocksToCount) return -1;
  int64_t lower = 0;
  for (const std::vector<int>& column : FindCoupledBlocks(problem, layout)) {
    lower += static_cast<int64_t>(column.size());
  }
  return static_cast<double>(2 * lower - n) / (static_cast<double>(n) * static_cast<double>(n));
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
      start_rotations_(static_cast<size_t>(problem.num_images) * 9),
      poses_(problem.num_images) {
  Reset();
}

void CameraStates::Reset() {
  camera_params_.assign(
      problem_.camera_params,
      problem_.camera_params + static_cast<std::ptrdiff_t>(problem_.num_cameras) * stride_);
  std::fill(charts_.begin(), charts_.end(), 0.0);
  for (int64_t i = 0; i < problem_.num_images; ++i) {
    const double* pose = problem_.cam_from_world + 7 * i;
    QuaternionToRotation(pose, &start_rotations_[9 * i]);
    std::copy(pose + 4, pose + 7, &charts_[kPoseSize * i + 3]);
  }
  Update(layout_.InitialState(problem_).data());
}

void CameraStates::Update(const double* state) {
  layout_.Scatter(problem_, state, charts_.data(), camera_params_.data());
  for (size_t i = 0; i < poses_.size(); ++i) {
    ExpandPose(&start_rotations_[9 * i], &charts_[kPoseSize * i], &poses_[i]);
  }
}

void CameraStates::CamFromWorld(int image, double pose[7]) const {
  const double* const w = chart(image);
  std::copy_n(problem_.cam_from_world + 7 * static_cast<int64_t>(image), 4, pose);
  std::copy_n(w + 3, 3, pose + 4);
  if (w[0] == 0 && w[1] == 0 && w[2] == 0) return;
  double increment[4], rotated[4];
  ExpQuaternion(w, increment);
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
