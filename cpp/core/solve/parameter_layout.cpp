#include "core/solve/parameter_layout.h"

#include <algorithm>
#include <utility>

namespace bundle {
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
      camera_block_(problem.num_cameras, -1) {
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::vector<int> users(problem.num_cameras);  // observed images of each camera
  for (int i = 0; i < problem.num_images; ++i) users[problem.image_camera[i]] += observed[i];
  for (int i = 0; i < problem.num_images; ++i) {
    const int camera = problem.image_camera[i];
    const bool own_camera = observed[i] && users[camera] == 1;
    image_block_[i] = AddBlock(free_.pose[i], own_camera ? free_.camera[camera] : 0);
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    if (users[c] > 1) camera_block_[c] = AddBlock(0, free_.camera[c]);
  }
  for (int i = 0; i < problem.num_images; ++i) {
    has_shared_intrinsics_ |= image_block_[i] >= 0 && camera_block_[problem.image_camera[i]] >= 0;
  }
  num_free_points_ = static_cast<int>(std::count(free_.point.begin(), free_.point.end(), 1));
}

int ParameterLayout::AddBlock(uint8_t pose_bits, uint32_t camera_bits) {
  CameraSideBlock block;
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
  std::vector<CameraSideBlock> blocks;
  std::vector<int> position(order.size());
  int offset = 0;
  for (const int block : order) {
    position[block] = static_cast<int>(blocks.size());
    blocks.push_back(blocks_[block]);
    blocks.back().offset = offset;
    offset += blocks.back().size;
  }
  blocks_ = std::move(blocks);
  for (std::vector<int>* index : {&image_block_, &camera_block_}) {
    for (int& block : *index) block = block < 0 ? -1 : position[block];
  }
}

bool ParameterLayout::IsRefined(const ProblemView& problem, int64_t observation) const {
  const int image = problem.observation_image[observation];
  return point_is_free(problem.observation_point[observation]) || image_block_[image] >= 0 ||
         camera_block_[problem.image_camera[image]] >= 0;
}

std::vector<double> ParameterLayout::InitialState(const ProblemView& problem) const {
  std::vector<double> state(state_size_);
  const auto fill = [&](int index, const double* translation, const double* params) {
    if (index < 0) return;
    const CameraSideBlock& block = blocks_[index];
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      state[block.offset + k] = column < 3           ? 0.0
                                : column < kPoseSize ? translation[column - 3]
                                                     : params[column - kPoseSize];
    }
  };
  for (int i = 0; i < problem.num_images; ++i) {
    fill(image_block_[i], problem.cam_from_world + 7 * static_cast<int64_t>(i) + 4,
         problem.ParamsOf(problem.image_camera[i]));
  }
  for (int c = 0; c < problem.num_cameras; ++c) {
    fill(camera_block_[c], nullptr, problem.ParamsOf(c));
  }
  return state;
}

void ParameterLayout::Scatter(const ProblemView& problem, const double* state, double* poses,
                              double* camera_params) const {
  const auto write = [&](int index, double* pose, double* params) {
    if (index < 0) return;
    const CameraSideBlock& block = blocks_[index];
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

}  // namespace bundle
