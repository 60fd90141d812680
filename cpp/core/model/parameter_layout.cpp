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
      params_block_(problem.num_cameras, -1),
      readout_block_(problem.num_cameras, -1) {
  const std::vector<uint32_t> own = FindTies(problem);
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::vector<int> users(problem.num_cameras);  // number of observed images of each camera
  for (int i = 0; i < problem.num_images; ++i) {
    // With an image of a rig, a camera has its own block, as if other images used it.
    const int weight = problem.FrameOf(i) < 0 ? 1 : 2;
    users[problem.image_camera[i]] += weight * observed[i];
  }
  for (int i = 0; i < problem.num_images; ++i) {
    const int camera = problem.image_camera[i];
    const bool own_camera = observed[i] && users[camera] == 1;
    pose_block_[i] = AddBlock(free_.pose[i], own_camera ? own[camera] : 0, free_.twist[i] != 0);
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
  for (int c = 0; c < problem.num_cameras; ++c) {
    // Its column is a placeholder outside the columns of a pose.
    if (free_.readout[c] != 0) readout_block_[c] = AddBlock(0, 1);
  }
  for (int p = 0; p < problem.num_points; ++p) {
    if (free_.point[p] == FreeParameters::kKeptPoint) kept_points_.push_back(p);
  }
  if (!kept_points_.empty()) kept_block_.assign(problem.num_points, -1);
  for (const int p : kept_points_) kept_block_[p] = AddBlock(0b111, 0);  // columns: coordinates
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
                        tied_block_.empty() ? -1 : tied_block_[problem.image_camera[i]],
                        -1,
                        -1,
                        -1};
    if (!HasHardTwist(i)) continue;
    for (const int side : {0, 1}) {
      const int other = problem.twist_neighbours[2 * i + side];
      if (other != i && free_.pose[other] != 0) {
        image_blocks_[i][kBeforeBlock + side] = pose_block_[other];
      }
    }
    image_blocks_[i][kReadoutBlock] = readout_block_[problem.image_camera[i]];
  }
}

int ParameterLayout::AddBlock(uint8_t pose_bits, uint32_t camera_bits, bool has_twist) {
  static_assert(kImageColumns <= 32);
  CameraBlock block;
  block.offset = state_size_;
  const uint32_t of_twist = has_twist ? (1u << kTwistSize) - 1 : 0;
  const uint32_t bits = pose_bits | camera_bits << kPoseSize | of_twist << kFirstTwist;
  for (int8_t j = 0; j < kImageColumns; ++j) {
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
  for (std::vector<int>* index : {&pose_block_, &camera_block_, &params_block_, &readout_block_}) {
    std::for_each(index->begin(), index->end(), renumber);
  }
  for (ImageBlocks& of : image_blocks_) std::for_each(of.begin(), of.end(), renumber);
  std::for_each(tied_block_.begin(), tied_block_.end(), renumber);
  std::for_each(kept_block_.begin(), kept_block_.end(), renumber);
  for (std::vector<TiedParameter>& ties : tied_) {
    for (TiedParameter& tie : ties) renumber(tie.block);
  }
}

bool ParameterLayout::IsRefined(const AdjustmentProblem& problem, int64_t observation) const {
  const ImageBlocks& blocks = image_blocks_[problem.observation_image[observation]];
  return free_.point[problem.observation_point[observation]] != 0 ||
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

template <typename Pose, typename Readout, typename Point>
std::vector<double> ParameterLayout::Gather(const AdjustmentProblem& problem, const Pose& of_pose,
                                            const double* camera_params, const Readout& of_readout,
                                            const Point& of_point) const {
  std::vector<double> state(state_size_);
  const auto fill = [&](int index, int pose, int camera) {
    if (index < 0) return;
    const CameraBlock& block = blocks_[index];
    const double* const params =
        camera_params + static_cast<int64_t>(camera) * problem.camera_params_stride;
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      const bool is_param = column >= kPoseSize && column < kFirstTwist;
      state[block.offset + k] = is_param ? params[column - kPoseSize] : of_pose(pose, column);
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
    if (readout_block_[c] >= 0) state[blocks_[readout_block_[c]].offset] = of_readout(c);
  }
  for (const int p : kept_points_) {
    for (int k = 0; k < 3; ++k) state[blocks_[kept_block_[p]].offset + k] = of_point(p, k);
  }
  return state;
}

std::vector<double> ParameterLayout::InitialState(const AdjustmentProblem& problem) const {
  const auto of_pose = [&](int pose, int column) {
    if (column >= kFirstTwist) return problem.TwistOf(pose)[column - kFirstTwist];
    return column < 3 ? 0.0 : ValueOfPose(problem, pose)[4 + column - 3];
  };
  return Gather(
      problem, of_pose, problem.camera_params, [&](int camera) { return problem.readouts[camera]; },
      [&](int point, int k) { return problem.points[3 * int64_t{point} + k]; });
}

StateBounds ParameterLayout::Bounds(const AdjustmentProblem& problem) const {
  if (problem.restrictions.camera_lower == nullptr) return {};
  StateBounds bounds;
  const auto below = [](auto...) { return -std::numeric_limits<double>::infinity(); };
  const auto above = [](auto...) { return std::numeric_limits<double>::infinity(); };
  bounds.lower = Gather(problem, below, problem.restrictions.camera_lower, below, below);
  bounds.upper = Gather(problem, above, problem.restrictions.camera_upper, above, above);
  const auto is_none = [](double bound) { return std::isinf(bound); };
  const bool has_none = std::all_of(bounds.lower.begin(), bounds.lower.end(), is_none) &&
                        std::all_of(bounds.upper.begin(), bounds.upper.end(), is_none);
  return has_none ? StateBounds() : bounds;
}

void ParameterLayout::Scatter(const AdjustmentProblem& problem, const double* state, double* poses,
                              double* camera_params, double* twists, double* readouts) const {
  const auto write = [&](int index, double* pose, double* params, double* twist) {
    if (index < 0) return;
    const CameraBlock& block = blocks_[index];
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      double& to = column < kPoseSize     ? pose[column]
                   : column < kFirstTwist ? params[column - kPoseSize]
                                          : twist[column - kFirstTwist];
      to = state[block.offset + k];
    }
  };
  const auto params_of = [&](int camera) {
    return camera_params + static_cast<int64_t>(camera) * problem.camera_params_stride;
  };
  for (int p = 0; p < NumPoses(problem); ++p) {
    write(pose_block_[p], poses + static_cast<int64_t>(p) * kPoseSize,
          p < problem.num_images ? params_of(problem.image_camera[p]) : nullptr,
          p < problem.num_images && twists != nullptr ? twists + int64_t{kTwistSize} * p : nullptr);
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    write(camera_block_[c], nullptr, params_of(c), nullptr);
    if (readout_block_[c] >= 0) readouts[c] = state[blocks_[readout_block_[c]].offset];
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

std::vector<int> ParameterLayout::BlockSizes() const {
  std::vector<int> sizes;
  sizes.reserve(blocks_.size());
  for (const CameraBlock& block : blocks_) sizes.push_back(block.size);
  return sizes;
}

}  // namespace bundle
