#include "core/model/parameter_layout.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/model/problem_factors.h"

namespace bundle {

const double* ValueOfPose(const ProblemView& problem, int pose) {
  const double* values = problem.cam_from_world;
  if (pose >= problem.num_images) {
    pose -= problem.num_images;
    values = problem.rig_from_world;
    if (pose >= problem.num_frames) {
      pose -= problem.num_frames;
      values = problem.sensor_from_rig;
    }
  }
  return values + 7 * static_cast<int64_t>(pose);
}

ParameterLayout::ParameterLayout(const AdjustmentProblem& problem, FreeParameters free)
    : free_(std::move(free)),
      pose_block_(NumPoses(problem), -1),
      camera_block_(problem.num_cameras, -1),
      params_block_(problem.num_cameras, -1) {
  const std::vector<uint32_t> own = FindTies(problem);
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::vector<int> users(problem.num_cameras);  // observed images of each camera
  for (int i = 0; i < problem.num_images; ++i) {
    // Beside an image of a rig, a camera has its own block as if others used it.
    const int weight = problem.FrameOf(i) < 0 ? 1 : 2;
    users[problem.image_camera[i]] += weight * observed[i];
  }
  for (int i = 0; i < problem.num_images; ++i) {
    const int camera = problem.image_camera[i];
    const bool own_camera = observed[i] && users[camera] == 1;
    pose_block_[i] = AddBlock(free_.pose[i], own_camera ? own[camera] : 0);
    if (own_camera && own[camera] != 0) params_block_[camera] = pose_block_[i];
  }
  for (int f = 0; f < problem.num_frames; ++f) {
    pose_block_[PoseOfFrame(problem, f)] = AddBlock(free_.frame[f], 0);
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    pose_block_[PoseOfSensor(problem, s)] = AddBlock(free_.sensor[s], 0);
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    if (users[c] != 1) params_block_[c] = camera_block_[c] = AddBlock(0, own[c]);
  }
  AddTiedBlocks();
  FindImageBlocks(problem);
  num_free_points_ = static_cast<int>(std::count(free_.point.begin(), free_.point.end(), 1));
}

void ParameterLayout::FindImageBlocks(const AdjustmentProblem& problem) {
  image_blocks_.resize(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    const int sensor = problem.SensorOf(i);
    image_blocks_[i] = {pose_block_[MovingPose(problem, i)],
                        sensor < 0 ? -1 : pose_block_[PoseOfSensor(problem, sensor)],
                        camera_block_[problem.image_camera[i]],
                        tied_block_.empty() ? -1 : tied_block_[problem.image_camera[i]]};
  }
}

std::vector<uint32_t> ParameterLayout::FindTies(const AdjustmentProblem& problem) {
  std::vector<uint32_t> own = free_.camera;
  if (problem.restrictions.camera_tie == nullptr) return own;
  struct Member {
    int camera;
    TiedParameter parameter;
  };
  std::vector<std::vector<Member>> members(problem.restrictions.num_ties);
  for (int c = 0; c < problem.num_cameras; ++c) {
    const int64_t first = static_cast<int64_t>(c) * problem.camera_params_stride;
    for (int j = 0; j < kMaxCameraParams; ++j) {
      if ((free_.camera[c] >> j & 1u) == 0 || problem.restrictions.camera_tie[first + j] < 0)
        continue;
      TiedParameter parameter;
      parameter.column = static_cast<int8_t>(kPoseSize + j);
      parameter.scale = problem.restrictions.camera_tie_scale[first + j];
      members[problem.restrictions.camera_tie[first + j]].push_back({c, parameter});
    }
  }
  tied_.resize(problem.num_cameras);
  tied_block_.assign(problem.num_cameras, -1);
  // Cameras that numbers tie to each other: the root of each (union-find).
  std::vector<int> parent(problem.num_cameras);
  for (int c = 0; c < problem.num_cameras; ++c) parent[c] = c;
  const auto root = [&](int c) {
    while (parent[c] != c) c = parent[c] = parent[parent[c]];
    return c;
  };
  const auto is_of_one_camera = [](const std::vector<Member>& tie) {
    return tie.empty() || tie.front().camera == tie.back().camera;
  };
  for (const std::vector<Member>& tie : members) {
    for (const Member& member : tie) {
      const int a = root(tie.front().camera), b = root(member.camera);
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  std::vector<int> component(problem.num_cameras, -1);
  for (std::vector<Member>& tie : members) {
    const bool is_own = is_of_one_camera(tie);
    int* found = is_own ? nullptr : &component[root(tie.front().camera)];
    if (found != nullptr && *found < 0) {
      *found = static_cast<int>(component_sizes_.size());
      component_sizes_.push_back(0);
    }
    const double scale = tie.empty() ? 1 : tie.front().parameter.scale;
    for (size_t m = is_own ? 1 : 0; m < tie.size(); ++m) {
      TiedParameter parameter = tie[m].parameter;
      if (is_own) {
        parameter.entry = tie.front().parameter.column;  // until its block is known
        parameter.scale /= scale;
      } else {
        parameter.block = *found;
        parameter.entry = component_sizes_[*found];
        parameter.is_first = m == 0;
      }
      own[tie[m].camera] &= ~(1u << (parameter.column - kPoseSize));
      tied_[tie[m].camera].push_back(parameter);
    }
    if (found != nullptr) ++component_sizes_[*found];
  }
  return own;
}

void ParameterLayout::AddTiedBlocks() {
  std::vector<int> block_of(component_sizes_.size());
  for (size_t k = 0; k < component_sizes_.size(); ++k) {
    if (component_sizes_[k] > ColumnMap::kMaxSize - kPoseSize) {
      throw InputError("camera_params: expected cameras that share at most " +
                       std::to_string(ColumnMap::kMaxSize - kPoseSize) +
                       " numbers, directly or by others, found " +
                       std::to_string(component_sizes_[k]));
    }
    block_of[k] = AddBlock(0, (1u << component_sizes_[k]) - 1);
  }
  for (int c = 0; c < static_cast<int>(tied_.size()); ++c) {
    for (TiedParameter& parameter : tied_[c]) {
      if (parameter.block >= 0) {
        parameter.block = tied_block_[c] = block_of[parameter.block];
        continue;
      }
      parameter.block = params_block_[c];
      const CameraBlock& block = blocks_[parameter.block];
      const auto* const place =
          std::find(block.columns, block.columns + block.size, parameter.entry);
      parameter.entry = static_cast<int>(place - block.columns);
    }
  }
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
  const auto renumber = [&](int& block) { block = block < 0 ? -1 : position[block]; };
  for (std::vector<int>* index : {&pose_block_, &camera_block_, &params_block_}) {
    std::for_each(index->begin(), index->end(), renumber);
  }
  for (ImageBlocks& of : image_blocks_) std::for_each(of.begin(), of.end(), renumber);
  std::for_each(tied_block_.begin(), tied_block_.end(), renumber);
  for (std::vector<TiedParameter>& ties : tied_) {
    for (TiedParameter& tie : ties) renumber(tie.block);
  }
}

bool ParameterLayout::IsRefined(const AdjustmentProblem& problem, int64_t observation) const {
  const ImageBlocks& blocks = image_blocks_[problem.observation_image[observation]];
  return point_is_free(problem.observation_point[observation]) ||
         std::any_of(blocks.begin(), blocks.end(), [](int block) { return block >= 0; });
}

std::set<int> ParameterLayout::BlocksBesideFirst() const {
  std::set<int> beside;
  for (const ImageBlocks& blocks : image_blocks_) {
    bool is_first = true;
    for (const int block : blocks) {
      if (block < 0) continue;
      if (!is_first) beside.insert(block);
      is_first = false;
    }
  }
  if (beside.empty()) return beside;
  for (const int block : camera_block_) {
    if (block >= 0) beside.insert(block);
  }
  return beside;
}

template <typename Pose>
std::vector<double> ParameterLayout::Gather(const AdjustmentProblem& problem, const Pose& of_pose,
                                            const double* camera_params) const {
  std::vector<double> state(state_size_);
  const auto fill = [&](int index, int pose, int camera) {
    if (index < 0) return;
    const CameraBlock& block = blocks_[index];
    const double* const params =
        camera_params + static_cast<int64_t>(camera) * problem.camera_params_stride;
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      state[block.offset + k] =
          column < kPoseSize ? of_pose(pose, column) : params[column - kPoseSize];
    }
  };
  for (int p = 0; p < NumPoses(problem); ++p) {
    fill(pose_block_[p], p, p < problem.num_images ? problem.image_camera[p] : 0);
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    fill(camera_block_[c], -1, c);
    const double* const params =
        camera_params + static_cast<int64_t>(c) * problem.camera_params_stride;
    for (const TiedParameter& tie : tied(c)) {
      if (!tie.is_first) continue;
      state[blocks_[tie.block].offset + tie.entry] = params[tie.column - kPoseSize] / tie.scale;
    }
  }
  return state;
}

std::vector<double> ParameterLayout::InitialState(const AdjustmentProblem& problem) const {
  const auto of_pose = [&](int pose, int column) {
    return column < 3 ? 0.0 : ValueOfPose(problem, pose)[4 + column - 3];
  };
  return Gather(problem, of_pose, problem.camera_params);
}

StateBounds ParameterLayout::Bounds(const AdjustmentProblem& problem) const {
  if (problem.restrictions.camera_lower == nullptr) return {};
  constexpr double kNone = std::numeric_limits<double>::infinity();
  StateBounds bounds;
  bounds.lower =
      Gather(problem, [](int, int) { return -kNone; }, problem.restrictions.camera_lower);
  bounds.upper = Gather(problem, [](int, int) { return kNone; }, problem.restrictions.camera_upper);
  const auto is_none = [](double bound) { return std::isinf(bound); };
  const bool has_none = std::all_of(bounds.lower.begin(), bounds.lower.end(), is_none) &&
                        std::all_of(bounds.upper.begin(), bounds.upper.end(), is_none);
  return has_none ? StateBounds() : bounds;
}

void ParameterLayout::Scatter(const AdjustmentProblem& problem, const double* state, double* poses,
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
  for (int p = 0; p < NumPoses(problem); ++p) {
    write(pose_block_[p], poses + static_cast<int64_t>(p) * kPoseSize,
          p < problem.num_images ? params_of(problem.image_camera[p]) : nullptr);
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    write(camera_block_[c], nullptr, params_of(c));
    for (const TiedParameter& tie : tied(c)) {
      params_of(c)[tie.column - kPoseSize] =
          tie.scale * state[blocks_[tie.block].offset + tie.entry];
    }
  }
}

ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals) {
  ProblemShape shape;
  shape.num_residuals = num_residuals;
  shape.num_free_points = layout.num_free_points();
  shape.num_camera_columns = layout.state_size();
  shape.num_camera_blocks = static_cast<int>(layout.blocks().size());
  return shape;
}

bool ParameterLayout::HasMap(const AdjustmentProblem& problem, int image, int place) const {
  const int block = image_blocks_[image][place];
  if (block < 0 || place == kSensorBlock) return false;
  if (place == kTiedBlock) return true;
  if (place == kPoseBlock && free_.pose[image] != 0 && TurnsAboutCentre(problem, image)) {
    return true;
  }
  const std::vector<TiedParameter>& ties = tied(problem.image_camera[image]);
  return std::any_of(ties.begin(), ties.end(),
                     [&](const TiedParameter& tie) { return tie.block == block; });
}

void ParameterLayout::FillMap(const AdjustmentProblem& problem, int image, int place,
                              const PoseState& pose, ColumnMap* map) const {
  const int index = image_blocks_[image][place];
  const CameraBlock& block = blocks_[index];
  map->num_columns = 0;
  const auto add_row = [&](int column) {
    double* const row = map->values + map->num_columns * block.size;
    std::fill_n(row, block.size, 0.0);
    map->columns[map->num_columns++] = static_cast<int8_t>(column);
    return row;
  };
  if (place != kTiedBlock) {
    for (int k = 0; k < block.size; ++k) add_row(block.columns[k])[k] = 1;
  }
  if (place == kPoseBlock && TurnsAboutCentre(problem, image)) {
    double by_turn[9];
    MinusCross(pose.translation, pose.left_jacobian, by_turn);
    for (int i = 0; i < 3; ++i) {
      double* const row = add_row(3 + i);
      for (int k = 0; k < block.size && block.columns[k] < 3; ++k) {
        row[k] = by_turn[3 * i + block.columns[k]];
      }
    }
  }
  for (const TiedParameter& tie : tied(problem.image_camera[image])) {
    if (tie.block == index) add_row(tie.column)[tie.entry] = tie.scale;
  }
}

uint32_t ParameterLayout::RefinedColumns(const AdjustmentProblem& problem, int image) const {
  uint32_t bits = 0;
  for (const int place : {kPoseBlock, kCameraBlock}) {
    const int index = image_blocks_[image][place];
    if (index < 0) continue;
    const CameraBlock& block = blocks_[index];
    for (int k = 0; k < block.size; ++k) bits |= 1u << block.columns[k];
  }
  if ((bits & FreeParameters::kWholePose) != 0 && TurnsAboutCentre(problem, image)) {
    bits |= FreeParameters::kWholePose;
  }
  for (const TiedParameter& tie : tied(problem.image_camera[image])) bits |= 1u << tie.column;
  return bits;
}

}  // namespace bundle
