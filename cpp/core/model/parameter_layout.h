#pragma once

/// Layout of the free parameters of a problem in one state vector.
///
/// The state is [block 0 | block 1 | ...]. A block has the free numbers of one image (pose, then
/// its camera's intrinsics if no other image uses that camera), or of one frame or one sensor of
/// rigs. An image with a rolling shutter has its twist there, too. Other blocks have the free
/// numbers of one camera: a camera that several images or an image of a rig use, or that has
/// factors and no observations; or the readout of a camera. Points are a separate array, but for
/// those that are not eliminated (kKeptPoint), which have blocks, too. A block has only refined
/// numbers, so that no solver gets constant numbers, subset manifolds or zero
/// columns. Blocks have equal sizes if the problem allows it, which fixed-size Schur kernels such
/// as Ceres' (2,3,6) and (2,3,9) require.
///
/// Columns of a camera Jacobian row: (w, t) of the pose from 0, intrinsics from 6, the twist from
/// kFirstTwist.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <set>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/reprojection.h"
#include "core/factors/twist_tie.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/free_parameters.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// Poses are numbered image by image, then frame by frame, then sensor by sensor. Poses of rig
/// images have a number but are not variables (factors/rig_pose.h).
inline int NumPoses(const ProblemView& problem) {
  return problem.num_images + problem.num_frames + problem.num_sensors;
}
inline int PoseOfFrame(const ProblemView& problem, int frame) { return problem.num_images + frame; }
inline int PoseOfSensor(const ProblemView& problem, int sensor) {
  return problem.num_images + problem.num_frames + sensor;
}
/// The pose that moves an image: its own or, on a rig, that of its frame.
inline int MovingPose(const ProblemView& problem, int image) {
  const int frame = problem.FrameOf(image);
  return frame < 0 ? image : PoseOfFrame(problem, frame);
}
/// qx qy qz qw tx ty tz in the problem.
const double* ValueOfPose(const ProblemView& problem, int pose);

/// A camera parameter that is a multiple of an unknown, like other parameters
/// (Restrictions::camera_tie).
struct TiedParameter {
  int8_t column = 0;  ///< as in CameraBlock
  int block = -1;
  int entry = 0;  ///< index of the unknown in the block
  double scale = 1;
  bool is_first = false;  ///< the state starts with the value of this parameter
};

/// Map from a step of the unknowns of a block to the columns of an image: M of schur/column_map.h
/// without its zero rows, num_columns x size, row-major.
struct ColumnMap {
  static constexpr int kMaxSize = kImageColumns;
  int num_columns = 0;
  int8_t columns[kMaxSize] = {};
  double values[kMaxSize * kMaxSize];
};

/// True if the centre of an image's camera is constant and its rotation is free. Its unknowns are
/// only w: with c the centre, t = -R c, and a step dw, which turns R to Exp(a) R for a = J_l dw,
/// moves t by
///
///   dt = -a x R c = a x t.
inline bool TurnsAboutCentre(const AdjustmentProblem& problem, int image) {
  return problem.restrictions.held_pose_parts != nullptr &&
         problem.restrictions.held_pose_parts[image] == kHeldPosition;
}

struct CameraBlock {
  int offset = 0;  ///< index of its first number in the state
  int size = 0;
  int8_t columns[kImageColumns] = {};  ///< columns of the image or camera, ascending
};

/// Bounds of the numbers in a state; empty if no number has bounds.
///
/// A candidate is projected onto the bounds, number by number. A number on a bound beyond which the
/// cost decreases is *active*: it stays constant until the gradient changes sign. Otherwise the
/// model would move it, and the numbers coupled to it, and the projection would undo the move. The
/// actual decrease would be far below the predicted one, and the trust region would reject every
/// step (D. P. Bertsekas: Projected Newton Methods for Optimization Problems with Simple
/// Constraints, 1982; Ceres has only the projection).
struct StateBounds {
  std::vector<double> lower, upper;

  bool empty() const { return lower.empty(); }
  /// The number within its bounds that is nearest to `value`.
  double Project(size_t j, double value) const {
    return empty() ? value : std::min(std::max(value, lower[j]), upper[j]);
  }
  bool IsOn(size_t j, double value) const { return value <= lower[j] || value >= upper[j]; }
  /// `gradient`: derivative of the cost with respect to the number.
  bool IsActive(size_t j, double value, double gradient) const {
    return (value <= lower[j] && gradient > 0) || (value >= upper[j] && gradient < 0);
  }
};

/// Parameters that are multiples of one number have one unknown. If all belong to one camera, the
/// unknown is the first of them, in the camera's block, and the others follow. If they belong to
/// several cameras, the unknown is in a block shared by all cameras that are tied to each other,
/// directly or through others. The columns of this block are placeholders outside the columns of a
/// pose.
class ParameterLayout {
 public:
  ParameterLayout(const AdjustmentProblem& problem, FreeParameters free);

  /// Permutes the blocks: block order[k] becomes block k.
  void Reorder(const std::vector<int>& order);

  const FreeParameters& free() const { return free_; }
  const std::vector<CameraBlock>& blocks() const { return blocks_; }
  std::vector<int> BlockSizes() const;
  int state_size() const { return state_size_; }
  int num_free_points() const { return num_free_points_; }
  /// False for constant points and for those with a block.
  bool point_is_free(int point) const { return free_.point[point] == 1; }

  /// Blocks on which an image's observations depend; -1: no block. They are: the block of its pose
  /// (its own, including intrinsics if merged, or its frame's), of its sensor, of its camera if not
  /// merged, of the parameters that its camera shares with others, and, if its twist is hard-tied,
  /// of the poses before and after and of the readout, as far as they differ from the first.
  enum {
    kPoseBlock,
    kSensorBlock,
    kCameraBlock,
    kTiedBlock,
    kBeforeBlock,
    kAfterBlock,
    kReadoutBlock,
    kNumPlaces
  };
  using ImageBlocks = std::array<int, kNumPlaces>;
  const ImageBlocks& blocks_of(int image) const { return image_blocks_[image]; }

  /// Index of the block with a pose, and with an image's intrinsics if merged; -1 if all are
  /// constant.
  int pose_block(int pose) const { return pose_block_[pose]; }
  /// pose_block of an image's own pose.
  int image_block(int image) const { return pose_block_[image]; }
  /// Index of the block with only a camera's intrinsics; -1 if merged or constant.
  int camera_block(int camera) const { return camera_block_[camera]; }
  /// Index of the block with a camera's intrinsics, its own or an image's; -1 if all are constant.
  int params_block(int camera) const { return params_block_[camera]; }
  /// Index of the block with a point that is not eliminated; -1 for all others.
  int kept_block(int point) const { return kept_block_.empty() ? -1 : kept_block_[point]; }
  /// Points with a block, ascending.
  const std::vector<int>& kept_points() const { return kept_points_; }
  /// Index of the block with a camera's readout only; -1 if it is constant.
  int readout_block(int camera) const { return readout_block_[camera]; }
  /// The parameters of a camera that are multiples of unknowns, except the unknowns themselves.
  const std::vector<TiedParameter>& tied(int camera) const {
    return tied_.empty() ? no_ties_ : tied_[camera];
  }
  /// True if the unknowns of an image's block, given by its index in ImageBlocks, move the columns
  /// of the image by a map. Not for blocks of sensors.
  bool HasMap(const AdjustmentProblem& problem, int image, int place) const;
  /// Writes this map, at a pose of the image. `twist`: of an image with a hard-tied twist; nullptr:
  /// only the columns of the map are needed.
  void FillMap(const AdjustmentProblem& problem, int image, int place, const PoseState& pose,
               const TwistMap* twist, ColumnMap* map) const;
  /// True if the observations of an image depend on the poses of others.
  bool HasHardTwist(int image) const { return free_.hard_twist[image] != 0; }
  bool HasHardTwists() const {
    return std::find(free_.hard_twist.begin(), free_.hard_twist.end(), 1) != free_.hard_twist.end();
  }
  /// Bit j: the observations of an image depend on unknowns through column j. Sensors are ignored.
  uint32_t RefinedColumns(const AdjustmentProblem& problem, int image) const;
  /// True if an observation depends on a free parameter.
  bool IsRefined(const AdjustmentProblem& problem, int64_t observation) const;
  /// Blocks that share a residual with the first block of an image. No residual contains two of the
  /// other blocks. If there are such blocks, they include shared cameras.
  std::set<int> BlocksBesideFirst() const;

  /// The state at the problem's own values: w = 0.
  std::vector<double> InitialState(const AdjustmentProblem& problem) const;

  StateBounds Bounds(const AdjustmentProblem& problem) const;

  /// Writes a state into poses (NumPoses x 6), camera parameters (as in ProblemView), twists and
  /// readouts. Numbers that are not in the state are not changed.
  void Scatter(const AdjustmentProblem& problem, const double* state, double* poses,
               double* camera_params, double* twists, double* readouts) const;

 private:
  int AddBlock(uint8_t pose_bits, uint32_t camera_bits, bool has_twist = false);
  /// Free parameters of each camera, except those in tied_. The blocks of tied parameters are not
  /// known yet, only the number of their component.
  std::vector<uint32_t> FindTies(const AdjustmentProblem& problem);
  void AddTiedBlocks();
  void FindImageBlocks(const AdjustmentProblem& problem);
  /// A state: of_pose(pose, column), also for columns of twists, camera parameters (as in
  /// ProblemView), of_readout(camera), of_point(point, coordinate).
  template <typename Pose, typename Readout, typename Point>
  std::vector<double> Gather(const AdjustmentProblem& problem, const Pose& pose,
                             const double* camera_params, const Readout& of_readout,
                             const Point& of_point) const;

  FreeParameters free_;
  std::vector<CameraBlock> blocks_;
  std::vector<int> pose_block_;
  std::vector<int> camera_block_;
  std::vector<int> params_block_;
  std::vector<int> readout_block_;
  std::vector<int> kept_points_;
  std::vector<int> kept_block_;  ///< per point; empty: all points are eliminated
  std::vector<ImageBlocks> image_blocks_;
  std::vector<std::vector<TiedParameter>> tied_;  ///< per camera; empty: no camera has ties
  std::vector<int> tied_block_;                   ///< per camera; -1: no block
  std::vector<int> component_sizes_;              ///< numbers that cameras share
  std::vector<TiedParameter> no_ties_;
  int state_size_ = 0;
  int num_free_points_ = 0;
};

/// Sizes that determine the cost of a linear solver.
struct ProblemShape {
  int64_t num_residuals = 0;
  int64_t num_free_points = 0;
  int64_t num_camera_columns = 0;  ///< scalar unknowns of the camera parameters
  int num_camera_blocks = 0;
};

/// `num_residuals` is the number of residuals that reach the solver.
ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals);

}  // namespace bundle
