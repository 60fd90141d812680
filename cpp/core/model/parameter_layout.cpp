#include "core/model/parameter_layout.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <set>
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

/// The pose of an image is its own, or that of its frame and sensor.
void FreePoseOf(const ProblemView& problem, const SolveOptions& options, int image,
                FreeParameters* free) {
  const int frame = problem.FrameOf(image), sensor = problem.SensorOf(image);
  if (options.refine_poses) {
    (frame < 0 ? free->pose[image] : free->frame[frame]) = FreeParameters::kWholePose;
  }
  if (options.refine_sensor_from_rig && sensor >= 0) {
    free->sensor[sensor] = FreeParameters::kWholePose;
  }
}

std::vector<uint8_t> FindObservedImages(const ProblemView& problem) {
  std::vector<uint8_t> observed(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) observed[problem.observation_image[i]] = 1;
  return observed;
}

void HoldSensorsWithoutReference(const ProblemView& problem, FreeParameters* free) {
  if (problem.num_sensors == 0) return;
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::set<int64_t> rigs;  // whose reference sensor observes something
  for (int i = 0; i < problem.num_images; ++i) {
    const int frame = problem.FrameOf(i);
    if (observed[i] && frame >= 0 && problem.SensorOf(i) < 0) {
      rigs.insert(problem.frame_rig_ids[frame]);
    }
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    if (rigs.count(problem.sensor_rig_ids[s]) == 0) free->sensor[s] = 0;
  }
}

void HoldSensors(const ProblemView& problem, const SolveOptions& options, FreeParameters* free) {
  for (const SensorId& id : options.fixed_sensors) {
    int found = 0;
    while (found < problem.num_sensors && (problem.sensor_rig_ids[found] != id.first ||
                                           problem.sensor_camera_ids[found] != id.second)) {
      ++found;
    }
    if (found == problem.num_sensors) {
      throw InputError("fixed_sensors: expected sensors with a sensor_from_rig, found rig " +
                       std::to_string(id.first) + ", camera " + std::to_string(id.second));
    }
    free->sensor[found] = 0;
  }
}

/// What factors touch may be seen by no observation.
void FreeTouched(const ProblemView& problem, const SolveOptions& options, FreeParameters* free) {
  for (const ProblemVariable& variable : problem.factors->variables) {
    switch (variable.kind) {
      case ProblemVariable::Kind::kImage:
        FreePoseOf(problem, options, variable.index, free);
        break;
      case ProblemVariable::Kind::kFrame:
        if (options.refine_poses) free->frame[variable.index] = FreeParameters::kWholePose;
        break;
      case ProblemVariable::Kind::kSensor:
        if (options.refine_sensor_from_rig) {
          free->sensor[variable.index] = FreeParameters::kWholePose;
        }
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
    // An image of a rig holds its frame, as one that is fixed does.
    const int frame = problem.FrameOf(i);
    uint8_t& bits = frame < 0 ? free->pose[i] : free->frame[frame];
    if (parts == (kHeldRotation | kHeldPosition)) bits = 0;
    if (parts == kHeldRotation) bits = static_cast<uint8_t>(bits & ~kRotation);
    // The translation follows (TurnsAboutCentre).
    if (parts == kHeldPosition) bits = static_cast<uint8_t>(bits & kRotation);
  }
}

}  // namespace

namespace {

/// What is one number is free as a whole.
void FreeTied(const ProblemView& problem, FreeParameters* free) {
  if (problem.camera_tie == nullptr) return;
  const int64_t stride = problem.camera_params_stride;
  const int num_params = std::min(problem.camera_params_stride, kMaxCameraParams);
  std::vector<bool> is_free(problem.num_ties);
  const auto for_ties = [&](const auto& visit) {
    for (int c = 0; c < problem.num_cameras; ++c) {
      for (int j = 0; j < num_params; ++j) {
        if (const int tie = problem.camera_tie[stride * c + j]; tie >= 0) visit(c, j, tie);
      }
    }
  };
  for_ties([&](int c, int j, int tie) {
    if (free->camera[c] >> j & 1u) is_free[tie] = true;
  });
  for_ties([&](int c, int j, int tie) {
    if (is_free[tie]) free->camera[c] |= 1u << j;
  });
}

}  // namespace

FreeParameters SelectFreeParameters(const ProblemView& problem, const SolveOptions& options) {
  FreeParameters free;
  free.pose.resize(problem.num_images);
  free.camera.resize(problem.num_cameras);
  free.point.resize(problem.num_points);
  free.frame.resize(problem.num_frames);
  free.sensor.resize(problem.num_sensors);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    FreePoseOf(problem, options, problem.observation_image[i], &free);
    if (options.refine_points) free.point[problem.observation_point[i]] = 1;
    const int camera = problem.image_camera[problem.observation_image[i]];
    if (free.camera[camera] == 0) {
      free.camera[camera] = FreeCameraParameters(*problem.camera_models[camera], options);
    }
  }
  if (problem.factors != nullptr) FreeTouched(problem, options, &free);
  HoldBetweenEqualBounds(problem, &free);
  HoldParts(problem, &free);
  HoldSensorsWithoutReference(problem, &free);
  HoldSensors(problem, options, &free);
  ForEachIndex("camera", options.fixed_camera_ids, problem.camera_ids, problem.num_cameras,
               [&](int index) { free.camera[index] = 0; });
  ForEachIndex("image", options.fixed_image_ids, problem.image_ids, problem.num_images,
               [&](int index) {
                 const int frame = problem.FrameOf(index);
                 (frame < 0 ? free.pose[index] : free.frame[frame]) = 0;
               });
  ForEachIndex("point", options.fixed_point_ids, problem.point_ids, problem.num_points,
               [&](int index) { free.point[index] = 0; });
  FreeTied(problem, &free);
  return free;
}

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

ParameterLayout::ParameterLayout(const ProblemView& problem, FreeParameters free)
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

void ParameterLayout::FindImageBlocks(const ProblemView& problem) {
  image_blocks_.resize(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    const int frame = problem.FrameOf(i), sensor = problem.SensorOf(i);
    image_blocks_[i] = {pose_block_[frame < 0 ? i : PoseOfFrame(problem, frame)],
                        sensor < 0 ? -1 : pose_block_[PoseOfSensor(problem, sensor)],
                        camera_block_[problem.image_camera[i]],
                        tied_block_.empty() ? -1 : tied_block_[problem.image_camera[i]]};
  }
}

std::vector<uint32_t> ParameterLayout::FindTies(const ProblemView& problem) {
  std::vector<uint32_t> own = free_.camera;
  if (problem.camera_tie == nullptr) return own;
  struct Member {
    int camera;
    TiedParameter parameter;
  };
  std::vector<std::vector<Member>> members(problem.num_ties);
  for (int c = 0; c < problem.num_cameras; ++c) {
    const int64_t first = static_cast<int64_t>(c) * problem.camera_params_stride;
    for (int j = 0; j < kMaxCameraParams; ++j) {
      if ((free_.camera[c] >> j & 1u) == 0 || problem.camera_tie[first + j] < 0) continue;
      TiedParameter parameter;
      parameter.column = static_cast<int8_t>(kPoseSize + j);
      parameter.scale = problem.camera_tie_scale[first + j];
      members[problem.camera_tie[first + j]].push_back({c, parameter});
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

bool ParameterLayout::HasMap(const ProblemView& problem, int image, int place) const {
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

void ParameterLayout::FillMap(const ProblemView& problem, int image, int place,
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

uint32_t ParameterLayout::RefinedColumns(const ProblemView& problem, int image) const {
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

bool ParameterLayout::IsRefined(const ProblemView& problem, int64_t observation) const {
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
std::vector<double> ParameterLayout::Gather(const ProblemView& problem, const Pose& of_pose,
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

std::vector<double> ParameterLayout::InitialState(const ProblemView& problem) const {
  const auto of_pose = [&](int pose, int column) {
    return column < 3 ? 0.0 : ValueOfPose(problem, pose)[4 + column - 3];
  };
  return Gather(problem, of_pose, problem.camera_params);
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

}  // namespace bundle
