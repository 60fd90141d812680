#pragma once

/// Factors beside the reprojections, in the reduced camera system: Ceres' NoEBlockRowsUpdate.
///
/// A factor with residual r and Jacobian J by the camera parameters alone (model/problem_factors.h;
/// both corrected for its loss) touches no point: the elimination of the points does not change it.
/// It adds
///
///   S += J^T J,    b -= J^T r,    gradient += J^T r,    ||J e_j||^2 to the squared norms,
///
/// before the damping, whose scale is that of the whole Jacobian. For a step d it adds
/// -(J d)^T (r + J d / 2) to the model's decrease, and for the two directions of a dogleg the
/// products of J p and J q.
///
/// A factor of one free point and nothing else that is free adds J^T J and J^T r to V and g of that
/// point (kernels/point_block.h), from where the passes over the points do the rest; only its cost
/// is summed up here.
///
/// Serial, in the order of the factors: no bit depends on the number of threads. Of a problem that
/// is divided among ranks, factors without a point are rank 0's, others those of the rank that has
/// the point.

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/linear/block_structure.h"
#include "core/minimize/least_squares.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/sums/double_double.h"

namespace bundle {

class CameraFactors {
 public:
  /// Keeps references to the problem and the structure. Every factor leaves the points apart
  /// (LeavesPointsApart).
  CameraFactors(const AdjustmentProblem& problem, const ParameterLayout& layout,
                const BlockStructure& structure, const EliminationPlan& plan);

  /// Number of factors with something to refine.
  int num_factors() const { return static_cast<int>(of_cameras_.size() + of_points_.size()); }
  int num_residuals() const { return num_residuals_; }
  /// True if AddTo adds anything.
  bool has_camera_factors() const { return !of_cameras_.empty(); }
  /// Cost of factors with nothing to refine, at a state; not finite if one has no value.
  double FixedCost(const CameraStates& cameras) const;
  /// True if a factor of a point has not the two rows of an observation.
  bool has_other_rows() const { return has_other_rows_; }

  /// Linearises at a state; `points` are three numbers for each point of the plan. Sets the input
  /// of the passes for points and keeps the Jacobians by camera parameters for the methods below.
  /// Returns the cost, which is not finite if a factor has no value.
  double Linearize(const CameraStates& cameras, const double* points);
  /// Adds the camera parameters' part of the normal equations.
  void AddTo(CameraSums* sums) const;

  /// Cost at a state. Also the costs of each kind of factor (KindOf) on this rank, in an order that
  /// is the same on all ranks; empty if no rank has factors.
  double Cost(const CameraStates& cameras, const double* points,
              std::vector<DoubleDouble>* kinds) const;

  /// d^T J^T r at a state, of a step of the camera parameters and one of the points.
  double Slope(const CameraStates& cameras, const double* points, const std::vector<double>& step,
               const double* points_step) const;

  /// -(J d)^T (r + J d / 2) of the camera parameters' factors.
  double ModelCostChange(const std::vector<double>& step) const;
  /// Adds the products of J p and J q of the camera parameters' factors.
  void AddProducts(const std::vector<double>& p, const std::vector<double>& q,
                   DoglegProducts* products) const;

  /// For EliminationInput; nullptr without factors of points.
  const int32_t* point_prior() const {
    return point_prior_.empty() ? nullptr : point_prior_.data();
  }
  const double* prior_sums() const { return prior_sums_.data(); }

 private:
  struct OfCameras {
    ChartedFactor factor;
    int64_t first_residual = 0;  ///< in residuals_
    int64_t first_entry = 0;     ///< in jacobians_
    std::vector<int> unknown;    ///< unknown of the state per column of the Jacobian
    std::vector<int64_t> entry;  ///< entry of S per pair of its blocks, the smaller first
  };
  struct OfPoint {
    ChartedFactor factor;
    int point = 0;  ///< in the plan
  };

  void AddAll(const AdjustmentProblem& problem, const ParameterLayout& layout,
              const EliminationPlan& plan);
  void FindKinds(const AdjustmentProblem& problem);
  void AddCameras(ChartedFactor factor, const ParameterLayout& layout);
  void AddPoint(ChartedFactor factor, int point);

  const BlockStructure& structure_;
  const std::vector<int64_t> diagonal_begin_;
  std::vector<OfCameras> of_cameras_;
  std::vector<OfPoint> of_points_;
  std::vector<ChartedFactor> fixed_;  ///< with nothing to refine
  size_t num_kinds_ = 0;              ///< on all ranks
  std::vector<int64_t> kind_;         ///< kind per factor: those of cameras, then those of points
  int num_residuals_ = 0;
  bool has_other_rows_ = false;
  std::vector<double> residuals_;  ///< residuals of camera factors, one after the other
  std::vector<double> jacobians_;
  std::vector<int32_t> point_prior_;  ///< per point of the plan: place in prior_sums_; -1: none
  /// Twelve numbers a point with factors: rows of J^T J, each followed by its entry of J^T r.
  std::vector<double> prior_sums_;
};

}  // namespace bundle
