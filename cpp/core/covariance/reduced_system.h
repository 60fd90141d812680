#pragma once

/// The normal equations of a problem at its own values, without damping, and their solution by the
/// reduced camera system:
///
///   [ U   W ] [x_c]   [b_c]        S = U - sum W_p V_p^-1 W_p^T,
///   [ W^T V ] [x_p] = [b_p]   =>   S x_c = b_c - sum W_p V_p^-1 b_p,
///                                  x_p = V_p^-1 (b_p - W_p^T x_c).
///
/// S is that of the solvers, summed up by their passes (schur/) and factorised by their direct
/// solvers (linear/). Null directions of points are left out (point_blocks.h): in the passes, a
/// factor on the point alone holds them constant.
///
/// A point that a factor joins with another free variable is not eliminated: it is one of the
/// unknowns x_c, and its observations add to U alone.
///
/// A camera parameter on an active bound, beyond which the cost decreases, is held constant: its
/// row and column of S are replaced by those of the identity.

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/covariance/observation_rows.h"
#include "core/covariance/point_blocks.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "core/prepare/prepare.h"
#include "core/schur/schur_problem.h"

namespace bundle {

class FreeGauge;  // free_gauge.h
class GaugeSums;  // gauge_sums.h

/// A free point with null directions.
struct NullPoint {
  int point = 0;
  int num_null = 0;     ///< number of null directions, up to three
  double direction[3];  ///< one of the null directions, of norm 1
  double projector[9];  ///< projector onto the null directions
  double root;          ///< square root of the approximate information along the other directions
};

/// The two parts of a vector of all free unknowns, or of several vectors (column-major).
struct FullVectors {
  int num_columns = 0;
  std::vector<double> cameras;  ///< unknowns of the layout x num_columns
  std::vector<double> points;   ///< 3 num_points x num_columns; zero for constant points
};

class ReducedSystem {
 public:
  /// Chooses and lays out the free parameters and linearises. The problem must be valid, with known
  /// camera models, and must outlive this object. `sums_gauge`: the pass over the points also
  /// computes the sums that a FreeGauge needs.
  ///
  /// Throws InputError if an id to be fixed does not exist, or if the memory does not suffice.
  ReducedSystem(const AdjustmentProblem& problem, const SolveOptions& options,
                bool sums_gauge = false);
  ~ReducedSystem();
  ReducedSystem(const ReducedSystem&) = delete;
  ReducedSystem& operator=(const ReducedSystem&) = delete;

  const AdjustmentProblem& problem() const { return problem_; }
  const ParameterLayout& layout() const { return layout_; }
  const ObservationEvaluator& evaluator() const { return *evaluator_; }
  const CameraStates& states() const { return evaluator_->states(); }
  const PointAssembler::Tracks& tracks() const { return tracks_; }
  int num_unknowns() const { return layout_.state_size(); }
  int num_threads() const { return num_threads_; }

  /// Sums over the observations of free points.
  struct PointSums {
    double squares = 0;  ///< sum of squared residuals
    int64_t num_residuals = 0;
    double decrease =
        0;  ///< 1/2 sum g_p^T V^-1 g_p: decrease of the cost if only the points were free
  };
  const PointSums& point_sums() const { return point_sums_; }

  /// nullptr: not requested, or V and W have changed since.
  const GaugeSums* gauge_sums() const { return has_scores_ ? nullptr : gauge_sums_.get(); }

  /// Ascending.
  const std::vector<NullPoint>& null_points() const { return null_points_; }
  /// Per unknown: 1 if it is held on a bound. Empty if no unknown is.
  const std::vector<uint8_t>& held() const { return held_; }
  /// Messages of the gauge choice, if a gauge could not be fixed as requested.
  const std::vector<Warning>& warnings() const { return warnings_; }

  /// Structure of the S in values(), with its blocks in the order of the layout.
  const BlockStructure& structure() const { return structure_; }
  /// Values of the blocks of S. Factorize may overwrite them; after Invert they are those of S^-1.
  BlockValues& values();
  const BlockValues& values() const;
  /// The right-hand side of a step: minus the gradient, points eliminated.
  const std::vector<double>& rhs() const;
  /// Entry (j, j) of S before the factorisation, for each unknown.
  const std::vector<double>& diagonal() const { return diagonal_; }

  /// Same as ObservationEvaluator::SetScores. V and W use the new scores; the caller has to set S.
  void SetScores(std::vector<double> scores, double kappa) {
    evaluator_->SetScores(std::move(scores), kappa);
    has_scores_ = true;
  }
  void SetSystem(BlockValues values);

  LinearSolution Factorize();
  /// Uses L, n x n and column-major, as the factor of a dense S.
  void TakeFactor(const double* lower);
  /// Exchanges S^-1 and a copy of the factor, so that Solve is allowed again after Invert.
  void ExchangeForFactor(BlockValues* factor);
  /// X = S^-1 B, unknowns x num_rhs, column-major.
  LinearSolution Solve(const double* rhs, int num_rhs, double* x);
  /// Solves the normal equations for all unknowns.
  LinearSolution Solve(const FullVectors& rhs, FullVectors* x);
  /// Replaces the factor by the blocks of S^-1 (LinearSolver::InvertBlocks), with zeros for
  /// unknowns on bounds.
  LinearSolution Invert();
  /// The minimum of L_jj^2 / S_jj after Factorize, and its unknown j. If S is singular, it consists
  /// of rounding errors only.
  double SmallestPivot(int* unknown) const;
  /// The maximum of (S^-1)_jj S_jj after Invert, and its unknown j. This is the ratio of a variance
  /// to the variance with all other unknowns known. Infinite if a ratio is clearly below 1, which
  /// only rounding can cause.
  double LargestInflation(int* unknown) const;

  /// True if S is dense, and the tracks are so short and few that long sums of their rows take
  /// little time.
  bool is_small() const;
  /// Lets ForPoints eliminate points from their rows (eliminated_rows.h).
  void EliminateByRows();
  /// Rows of the point's own factors, whitened, three columns each. Call after EliminateByRows.
  const std::vector<double>& point_prior_rows(int point) const;

  /// Calls visit(point, its blocks, its rows, thread) for every free point, on all threads. Points
  /// seen by the same images are consecutive, so that their blocks of S are in the cache.
  using PointVisitor =
      std::function<void(int point, const PointBlocks&, const PointAssembler&, int thread)>;
  void ForPoints(const PointVisitor& visit) const { ForPoints(num_threads_, point_order_, visit); }
  /// Same as ForPoints, with a given number of threads.
  void ForPoints(int num_threads, const PointVisitor& visit) const {
    ForPoints(num_threads, point_order_, visit);
  }
  /// Same as ForPoints, for these points only.
  void ForPoints(int num_threads, const std::vector<int>& points, const PointVisitor& visit) const;
  /// In the order of their first blocks.
  const std::vector<int>& free_points() const { return point_order_; }
  /// Free points that the kernels leave out: those whose V is not clearly regular, or with very
  /// many observations. All points if the system has no unknowns.
  const std::vector<int>& unclear_points() const { return unclear_points_; }
  /// PointPasses::FindCovariances, with blocks in the structure of S.
  void FindPointCovariances(const FreeGauge* gauge, double* to) const;
  /// PointPasses::FindLeverages, by the values of the system unless `is_without`.
  void FindLeverages(bool is_without, const double* adjoint, double* covariances,
                     const std::function<void(int64_t, const ObservationLeverage&)>& visit) const;
  /// PointPasses::FindMovements
  void FindMovements(
      const double* by_unknown, int num_quads, const std::vector<uint8_t>& is_wanted,
      const std::function<void(int, const double*, const double*, int)>& visit) const;
  /// Rows of a factor's Jacobian w.r.t. the free variables: three columns per point, then unknowns.
  struct FactorRows {
    int factor = 0;  ///< its index
    int num_rows = 0;
    int num_measurements = 0;  ///< independent rows
    std::vector<int> points;
    std::vector<int> unknowns;
    std::vector<double> residual;  ///< num_rows, weighted by the loss
    std::vector<double>
        jacobian;  ///< num_rows x (3 points + unknowns), row-major, weighted by the loss
  };
  /// Calls visit(rows) for every factor of the problem that has a value, in order.
  void ForFactors(const std::function<void(const FactorRows&)>& visit) const;
  /// Calls visit(rows) for the observations of points that are constant or not eliminated, except
  /// those that do not count.
  void ForObservationsOfFixedPoints(const std::function<void(const ObservationRows&)>& visit) const;

  /// Block (row, column) of a matrix with the structure of S, rows of block `row` x columns of
  /// block `column`, row-major. The block must be in the structure.
  void CopyBlock(const BlockValues& values, int row, int column, double* out) const {
    bundle::CopyBlock(structure_, values, row, column, out);
  }
  /// True if block (row, column) is in the structure.
  bool HasBlock(int row, int column) const;

 private:
  ReducedSystem(const AdjustmentProblem& problem, const SolveOptions& options,
                PreparedSolve prepared, bool sums_gauge);
  void Order();
  void OrderPoints();
  void FindNullPoints();
  void AddResiduals(int point, const PointBlocks& blocks, const PointAssembler& rows,
                    PointSums* sums) const;
  void HoldNullDirections();
  void LinearizeSchur(const SolveOptions& options);
  void AddKeptPoints();
  void FinishLinearization();
  void ReadDiagonal();

  const AdjustmentProblem& problem_;
  const int num_threads_;
  std::vector<Warning> warnings_;
  ParameterLayout layout_;
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  std::unique_ptr<ObservationEvaluator> evaluator_;
  PointAssembler::Tracks tracks_;
  std::vector<int> point_order_;  ///< free points
  std::vector<int> unclear_points_;
  PointSums point_sums_;
  std::unique_ptr<GaugeSums> gauge_sums_;
  std::vector<NullPoint> null_points_;
  ProblemFactors factors_;  ///< the factors of the problem, and those that hold null directions
  AdjustmentProblem view_;  ///< the problem with factors_
  std::unique_ptr<SchurProblem> schur_;
  bool is_finite_ = true;  ///< result of the linearisation
  bool has_scores_ = false;
  bool by_rows_ = false;
  std::map<int, std::vector<double>> prior_rows_;  ///< per point; computed by EliminateByRows
  std::vector<uint8_t> held_;
  std::vector<double> diagonal_;
  BlockValues no_values_;       ///< values of a system without unknowns
  std::vector<double> no_rhs_;  ///< its right-hand side
};

}  // namespace bundle
