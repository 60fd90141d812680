#pragma once

/// Which numbers of a problem a solve may change.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/reprojection.h"
#include "core/interface/options.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// Bit j of a pose: entry j of (w, t) (factors/reprojection.h). Bit j of a camera: parameter j.
struct FreeParameters {
  static constexpr uint8_t kWholePose = 0b111111;

  std::vector<uint8_t> pose;     ///< num_images
  std::vector<uint32_t> camera;  ///< num_cameras
  std::vector<uint8_t> point;    ///< num_points: 0 or 1

  bool operator==(const FreeParameters& other) const {
    return pose == other.pose && camera == other.camera && point == other.point;
  }
};

/// What the options leave free. Nothing is free that neither an observation nor a factor touches.
/// Throws InputError if an id to be fixed is not in the problem.
FreeParameters SelectFreeParameters(const ProblemView& problem, const SolveOptions& options);

/// How the free parameters of a problem lie in one state vector.
///
/// The state is [block 0 | block 1 | ...], each block the free numbers of one image (pose, then its
/// camera's intrinsics if no other image uses that camera) or of one camera that several images
/// share, or that a factor touches and no observation; points stay an array of their own. A block
/// holds only what is refined, so nothing constant reaches a solver: no subset manifolds, no zero
/// columns, and blocks of one size wherever the problem allows it, which is what fixed-size Schur
/// kernels such as Ceres' (2,3,6) and (2,3,9) ask for.
///
/// Column j of a camera Jacobian row counts (w, t) of the pose as 0..5 and intrinsics from 6.

inline constexpr int kPoseSize = 6;

struct CameraBlock {
  int offset = 0;  ///< of its first number in the state
  int size = 0;
  int8_t columns[kPoseSize + kMaxCameraParams] = {};  ///< what they are, ascending
};

/// Bounds of the numbers in a state; no numbers where none of them has any.
///
/// A candidate is projected onto them, number by number. A number on a bound beyond which the cost
/// falls is *active*: it stays until the gradient turns. Without that, the model of a step would
/// move it, and the numbers coupled to it, to where the projection takes it back; the decrease that
/// the model promises does not come, and a trust region rejects every step (D. P. Bertsekas:
/// Projected Newton Methods for Optimization Problems with Simple Constraints, 1982; Ceres knows
/// the projection only).
struct StateBounds {
  std::vector<double> lower, upper;

  bool empty() const { return lower.empty(); }
  /// The number within its bounds that is nearest to `value`.
  double Project(size_t j, double value) const {
    return empty() ? value : std::min(std::max(value, lower[j]), upper[j]);
  }
  bool IsOn(size_t j, double value) const { return value <= lower[j] || value >= upper[j]; }
  /// `gradient`: of the cost by the number.
  bool IsActive(size_t j, double value, double gradient) const {
    return (value <= lower[j] && gradient > 0) || (value >= upper[j] && gradient < 0);
  }
};

class ParameterLayout {
 public:
  ParameterLayout(const ProblemView& problem, FreeParameters free);

  /// Puts the blocks into another order: order[k] becomes the k-th.
  void Reorder(const std::vector<int>& order);

  const FreeParameters& free() const { return free_; }
  const std::vector<CameraBlock>& blocks() const { return blocks_; }
  int state_size() const { return state_size_; }
  int num_free_points() const { return num_free_points_; }
  bool point_is_free(int point) const { return free_.point[point] != 0; }

  /// Index of the block with an image's pose, and its intrinsics where merged; -1 if all is fixed.
  int image_block(int image) const { return image_block_[image]; }
  /// Index of the block with a shared camera's intrinsics; -1 if merged or fixed.
  int camera_block(int camera) const { return camera_block_[camera]; }
  /// Index of the block with a camera's intrinsics, its own or an image's; -1 if all are fixed.
  int params_block(int camera) const { return params_block_[camera]; }
  /// True if an observation depends on something free.
  bool IsRefined(const ProblemView& problem, int64_t observation) const;
  /// True if some image has both kinds of block.
  bool has_shared_intrinsics() const { return has_shared_intrinsics_; }

  /// The state at the problem's own values: w = 0.
  std::vector<double> InitialState(const ProblemView& problem) const;

  StateBounds Bounds(const ProblemView& problem) const;

  /// Writes a state into poses (num_images x 6) and camera parameters (as in ProblemView); what is
  /// not in the state is left alone.
  void Scatter(const ProblemView& problem, const double* state, double* poses,
               double* camera_params) const;

 private:
  int AddBlock(uint8_t pose_bits, uint32_t camera_bits);
  /// A state: pose(image, column) of the poses, and camera parameters (as in ProblemView).
  template <typename Pose>
  std::vector<double> Gather(const ProblemView& problem, const Pose& pose,
                             const double* camera_params) const;

  FreeParameters free_;
  std::vector<CameraBlock> blocks_;
  std::vector<int> image_block_;
  std::vector<int> camera_block_;
  std::vector<int> params_block_;
  int state_size_ = 0;
  int num_free_points_ = 0;
  bool has_shared_intrinsics_ = false;
};

/// The sizes that decide what a linear solver costs.
struct ProblemShape {
  int64_t num_residuals = 0;
  int64_t num_free_points = 0;
  int64_t num_camera_columns = 0;  ///< scalar unknowns of the camera parameters
  int num_camera_blocks = 0;
};

/// `num_residuals` is the number of residuals that reach the solver.
ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals);

/// One anchor per image (factors/reprojection.h).
using PoseAnchors = std::vector<PoseAnchor>;

/// The camera parameters of a problem at one state, expanded once per evaluation so that an
/// observation only reads: rotation, translation and left Jacobian of each image, parameters of
/// each camera.
///
/// A state has a meaning about certain anchors only: a candidate needs those of the state that the
/// step starts from.
class CameraStates {
 public:
  /// Keeps references to both; starts at the problem's own values.
  CameraStates(const ProblemView& problem, const ParameterLayout& layout);

  /// Goes to the problem's own values, after these changed.
  void Reset();

  void Update(const double* state);

  /// Gives each image that is too far from its anchor a new one, where it is. Same state, same
  /// poses. True if there is any; others keep every bit.
  bool MoveAnchors();
  /// From the next Update on. They are never changed, but replaced.
  void SetAnchors(std::shared_ptr<const PoseAnchors> anchors) { anchors_ = std::move(anchors); }
  const std::shared_ptr<const PoseAnchors>& anchors() const { return anchors_; }

  /// R_a of an image.
  const double* anchor_rotation(int image) const { return (*anchors_)[image].rotation; }
  /// (v, t) of an image, six numbers.
  void Chart(int image, double* chart) const;
  const PoseState& pose(int image) const { return poses_[image]; }
  const double* params(int camera) const {
    return camera_params_.data() + static_cast<int64_t>(camera) * stride_;
  }

  /// The refined poses as quaternion and translation (num_images x 7): Exp(v) q_a. A pose that did
  /// not move keeps every bit of what it was.
  std::vector<double> CamFromWorld() const;
  void CamFromWorld(int image, double pose[7]) const;
  const std::vector<double>& camera_params() const { return camera_params_; }

 private:
  void Expand(int image);

  const ProblemView& problem_;
  const ParameterLayout& layout_;
  const int stride_;
  std::shared_ptr<const PoseAnchors> anchors_;
  std::vector<double> charts_;  ///< (w, t) of each image
  std::vector<PoseState> poses_;
  std::vector<double> camera_params_;
};

}  // namespace bundle
