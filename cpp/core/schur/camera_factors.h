#pragma once

/// Contribution of factors without points to the reduced camera system: Ceres' NoEBlockRowsUpdate.
///
/// A factor with residual r and Jacobian J w.r.t. the camera parameters alone
/// (model/problem_factors.h; both corrected for its loss) depends on no point. The elimination of
/// the points does not change it. It adds
///
///   S += J^T J,    b -= J^T r,    gradient += J^T r,    ||J e_j||^2 to the squared norms,
///
/// before the damping, which is scaled by the norms of all rows of the Jacobian. For a step d it
/// adds -(J d)^T (r + J d / 2) to the model's decrease. For the two directions of a dogleg it adds
/// the products of J p and J q.
///
/// A factor whose only free variable is one point adds J^T J and J^T r to V and g of that point
/// (kernels/point_block.h). The passes over the points then include it. Only its cost is summed up
/// here.
///
/// Factors are computed serially, in their order, so that the bits do not depend on the threads.
/// If a problem is divided among ranks, rank 0 has the factors without a point. Each factor of a
/// point belongs to the rank of the point.

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
  /// Keeps references to the problem and the structure. Every factor must satisfy
  /// LeavesPointsApart.
  CameraFactors(const AdjustmentProblem& problem, const ParameterLayout& layout,
                const BlockStructure& structure, const EliminationPlan& plan);

  /// Number of factors with free parameters.
  int num_factors() const { return static_cast<int>(of_cameras_.size() + of_points_.size()); }
  int num_residuals() const { return num_residuals_; }
  /// True if AddTo adds anything.
  bool has_camera_factors() const { return !of_cameras_.empty(); }
  /// Cost of factors without free parameters, at a state; not finite if one of them has no value.
  double FixedCost(const CameraStates& cameras) const;
  /// True if a factor of a point has a number of rows other than two, which an observation has.
  bool has_other_rows() const { return has_other_rows_; }

  /// Linearises at a state; `points` are three numbers for each point of the plan. Sets the input
  /// of the passes for points and keeps the Jacobians by camera parameters for the methods below.
  /// Returns the cost, which is not finite if a factor has no value.
  double Linearize(const CameraStates& cameras, const double* points);
  /// Adds the camera parameters' part of the normal equations.
  void AddTo(CameraSums* sums) const;

  /// Cost at a state. Also returns the costs of each kind of factor (KindOf) on this rank, in an
  /// order that is the same on all ranks; empty if no rank has factors.
  double Cost(const CameraStates& cameras, const double* points,
              std::vector<DoubleDouble>* kinds) const;
  /// Expected cost of each kind on all ranks, if the sigmas are right: 1/2 per residual.
  const std::vector<double>& expected_costs() const { return expected_costs_; }

  /// d^T J^T r at a state, for a step of the camera parameters and a step of the points.
  double Slope(const CameraStates& cameras, const double* points, const std::vector<double>& step,
               const double* points_step) const;

  /// -(J d)^T (r + J d / 2) of the factors of camera parameters.
  double ModelCostChange(const std::vector<double>& step) const;
  /// Adds the products of J p and J q of the factors of camera parameters.
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
    std::vector<int64_t> entry;  ///< entry of S for each pair of its blocks, the smaller first
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
  std::vector<ChartedFactor> fixed_;  ///< factors without free parameters
  size_t num_kinds_ = 0;              ///< on all ranks
  std::vector<double> expected_costs_;
  std::vector<int64_t> kind_;  ///< kind per factor: those of cameras, then those of points
  int num_residuals_ = 0;
  bool has_other_rows_ = false;
  std::vector<double> residuals_;  ///< residuals of camera factors, one after the other
  std::vector<double> jacobians_;
  std::vector<int32_t> point_prior_;  ///< per point of the plan: place in prior_sums_; -1: none
  /// Twelve numbers per point with factors: rows of J^T J, each followed by its entry of J^T r.
  std::vector<double> prior_sums_;
};

}  // namespace bundle
