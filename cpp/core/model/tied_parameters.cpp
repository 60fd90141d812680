/// Part of ParameterLayout (parameter_layout.h): camera parameters that are multiples of one
/// number, and images that turn about their centre. The unknowns of their blocks move the columns
/// of an image by maps.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/factors/rig_pose.h"
#include "core/geometry/rotation.h"
#include "core/model/parameter_layout.h"

namespace bundle {

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
        parameter.entry = tie.front().parameter.column;  // replaced once its block is known
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
    if (component_sizes_[k] > kMaxCameraParams) {
      throw InputError("camera_params: expected a group of cameras that share at most " +
                       std::to_string(kMaxCameraParams) + " numbers, found " +
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

bool ParameterLayout::HasMap(const AdjustmentProblem& problem, int image, int place) const {
  const int block = image_blocks_[image][place];
  if (block < 0 || place == kSensorBlock) return false;
  if (place >= kTiedBlock) return true;
  if (place == kPoseBlock && HasHardTwist(image) && free_.pose[image] != 0 &&
      (problem.twist_neighbours[2 * image] == image ||
       problem.twist_neighbours[2 * image + 1] == image)) {
    return true;
  }
  if (place == kPoseBlock && free_.pose[image] != 0 && TurnsAboutCentre(problem, image)) {
    return true;
  }
  const std::vector<TiedParameter>& ties = tied(problem.image_camera[image]);
  return std::any_of(ties.begin(), ties.end(),
                     [&](const TiedParameter& tie) { return tie.block == block; });
}

void ParameterLayout::FillMap(const AdjustmentProblem& problem, int image, int place,
                              const PoseState& pose, const TwistMap* twist, ColumnMap* map) const {
  const int index = image_blocks_[image][place];
  const CameraBlock& block = blocks_[index];
  map->num_columns = 0;
  const auto add_row = [&](int column) {
    double* const row = map->values + map->num_columns * block.size;
    std::fill_n(row, block.size, 0.0);
    map->columns[map->num_columns++] = static_cast<int8_t>(column);
    return row;
  };
  const auto add_twist = [&](const double* by_pose) {
    for (int i = 0; i < kTwistSize; ++i) {
      double* const row = add_row(kFirstTwist + i);
      for (int k = 0; by_pose != nullptr && k < block.size && block.columns[k] < kPoseSize; ++k) {
        row[k] = by_pose[kPoseSize * i + block.columns[k]];
      }
    }
  };
  if (place >= kBeforeBlock) {
    if (place == kReadoutBlock) {
      for (int i = 0; i < kTwistSize; ++i) {
        add_row(kFirstTwist + i)[0] = twist == nullptr ? 0 : twist->readout[i];
      }
    } else {
      add_twist(twist == nullptr ? nullptr : place == kBeforeBlock ? twist->before : twist->after);
    }
    return;
  }
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
  if (place == kPoseBlock && HasHardTwist(image) && free_.pose[image] != 0) {
    const int32_t* const sides = problem.twist_neighbours + 2 * int64_t{image};
    if (sides[0] == image) add_twist(twist == nullptr ? nullptr : twist->before);
    if (sides[1] == image) add_twist(twist == nullptr ? nullptr : twist->after);
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
  bool has_twist = HasHardTwist(image) && HasMap(problem, image, kPoseBlock);
  for (const int place : {kBeforeBlock, kAfterBlock, kReadoutBlock}) {
    has_twist |= image_blocks_[image][place] >= 0;
  }
  if (has_twist) bits |= ((1u << kTwistSize) - 1) << kFirstTwist;
  return bits;
}

}  // namespace bundle
