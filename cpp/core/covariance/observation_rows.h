#pragma once

/// Rows of a problem's Jacobian at its own values, w.r.t. the unknowns of a layout, one observation
/// at a time.
///
/// An observation's residual r (2) is divided by its sigma s and weighted by its loss,
///
///   r~ = sqrt(rho'(||r / s||^2)) r / s,        J~ alike,
///
/// so that J~^T J~ is its block of the Gauss-Newton matrix of the solvers (factors/loss.h). The
/// second derivative of the loss adds beta g g^T with g = J~^T r~ and beta = 2 rho'' / rho'^2
/// (leverages.h). Rows w.r.t. the local columns of an image, (w, t) and intrinsics, are mapped to
/// the blocks of the layout by schur/column_map.h and factors/rig_pose.h.

#include <cstdint>
#include <utility>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Map M from the unknowns of one block to the local columns of an image. A row a by local columns
/// becomes the row a M by unknowns.
struct LocalMap {
  int block = -1;
  int size = 0;                 ///< number of unknowns of the block
  std::vector<int8_t> columns;  ///< local columns that the unknowns move
  std::vector<double> values;   ///< M, columns x size, row-major; empty: unknown k is columns[k]
};

/// The maps of all blocks on which an image's observations depend, at the problem's own values.
/// Maps of the unknowns marked in `held` are zero (one entry per unknown; empty: none marked).
std::vector<LocalMap> FindLocalMaps(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& states, int image,
                                    const std::vector<uint8_t>& held);

/// Whitened by the sigma and weighted by the loss, row-major.
struct ObservationRows {
  static constexpr int kMaxBlocks = ParameterLayout::kNumPlaces + 1;
  int64_t observation;
  double residual[2];
  double score[2];  ///< J~^T score enters the sandwich; the residual until SetScores
  double point[2 * 3];
  double bend;    ///< beta
  double weight;  ///< kappa rho', with the kappa of SetScores
  int num_image_blocks = 0;
  int num_blocks = 0;  ///< those of the image, then that of a point that is not eliminated
  int block[kMaxBlocks];
  int size[kMaxBlocks];
  double jacobian[kMaxBlocks][2 * BlockSystem::kMaxBlockSize];  ///< 2 x size each
};

class ObservationEvaluator {
 public:
  /// Keeps references to the problem and the layout. Loss and cheirality are those of the options.
  ObservationEvaluator(const AdjustmentProblem& problem, const ParameterLayout& layout,
                       const SolveOptions& options);

  /// False if the observation does not count (factors/reprojection.h). `by_params`: also the rows
  /// by all parameters of the camera's model, 2 x their number.
  bool Evaluate(int64_t observation, ObservationRows* rows, double* by_params = nullptr) const;

  /// Adds J^T v by the unknowns of the layout, all parameters of the camera's model and the point,
  /// without sigma and loss; nothing if the observation does not count.
  void AddTransposed(int64_t observation, const double v[2], double* unknowns, double* params,
                     double* point) const;

  /// rho, rho' and rho'' of a residual over its sigma.
  void LossOf(const double residual[2], double rho[3]) const;

  const CameraStates& states() const { return states_; }
  const std::vector<LocalMap>& maps(int image) const { return maps_[image]; }
  /// Multiplies J~^T J~ by kappa from now on, and takes J~^T score from these scores, two numbers
  /// per observation of the problem (leverages.h).
  void SetScores(std::vector<double> scores, double kappa);
  /// Evaluates from now on at a state of the layout and at these points, which the caller keeps.
  void MoveTo(const double* state, const double* points, const std::vector<uint8_t>& held);
  /// Holds the marked unknowns constant from now on.
  void Hold(const std::vector<uint8_t>& held);

 private:
  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  CameraStates states_;
  const double* points_;
  std::vector<std::vector<LocalMap>> maps_;  ///< per image
  std::vector<double> scores_;
  double root_curvature_ = 1;
  const LossType loss_;
  const double loss_scale_;
  const Cheirality cheirality_;
};

}  // namespace bundle
