#pragma once

/// How the free parameters of a problem lie in one state vector.
///
/// The state is [block 0 | block 1 | ...], each block the free numbers of one image (pose, then its
/// camera's intrinsics if no other image uses that camera) or of one camera that several images
/// share; points stay an array of their own. A block holds only what is refined, so nothing
/// constant reaches a solver: no subset manifolds, no zero columns, and blocks of one size wherever
/// the problem allows it, which is what fixed-size Schur kernels such as Ceres' (2,3,6) and (2,3,9)
/// ask for.
///
/// Column j of a camera-side Jacobian row counts (w, t) of the pose as 0..5 and intrinsics from 6.

#include <cstdint>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/problem/problem_view.h"
#include "core/solve/free_parameters.h"

namespace bundle {

inline constexpr int kPoseSize = 6;

struct CameraSideBlock {
  int offset = 0;  ///< of its first number in the state
  int size = 0;
  int8_t columns[kPoseSize + kMaxCameraParams] = {};  ///< what they are, ascending
};

class ParameterLayout {
 public:
  ParameterLayout(const ProblemView& problem, FreeParameters free);

  /// Puts the blocks into another order: order[k] becomes the k-th.
  void Reorder(const std::vector<int>& order);

  const std::vector<CameraSideBlock>& blocks() const { return blocks_; }
  int state_size() const { return state_size_; }
  int num_free_points() const { return num_free_points_; }
  bool point_is_free(int point) const { return free_.point[point] != 0; }

  /// Index of the block with an image's pose, and its intrinsics where merged; -1 if all is fixed.
  int image_block(int image) const { return image_block_[image]; }
  /// Index of the block with a shared camera's intrinsics; -1 if merged or fixed.
  int camera_block(int camera) const { return camera_block_[camera]; }
  /// True if an observation depends on something free.
  bool IsRefined(const ProblemView& problem, int64_t observation) const;
  /// True if some image has both kinds of block.
  bool has_shared_intrinsics() const { return has_shared_intrinsics_; }

  /// The state at the problem's own values: w = 0.
  std::vector<double> InitialState(const ProblemView& problem) const;

  /// Writes a state into poses (num_images x 6) and camera parameters (as in ProblemView); what is
  /// not in the state is left alone.
  void Scatter(const ProblemView& problem, const double* state, double* poses,
               double* camera_params) const;

 private:
  int AddBlock(uint8_t pose_bits, uint32_t camera_bits);

  FreeParameters free_;
  std::vector<CameraSideBlock> blocks_;
  std::vector<int> image_block_;
  std::vector<int> camera_block_;
  int state_size_ = 0;
  int num_free_points_ = 0;
  bool has_shared_intrinsics_ = false;
};

}  // namespace bundle
