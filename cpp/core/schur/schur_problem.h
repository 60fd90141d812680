#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/least_squares.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/assembly/ordered_sums.h"
#include "core/schur/assembly/sum_grid.h"
#include "core/schur/camera_factors.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/held_residuals.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/schur_setup.h"
#include "core/schur/state_records.h"
#include "core/scratch/large_vector.h"
#include "core/sums/communicator.h"
#include "core/sums/double_double.h"

namespace bundle {

/// Bundle adjustment with eliminated points: a LeastSquares implemented by passes over the points.
class SchurProblem final : public LeastSquares {
 public:
  /// Keeps references to the problem, the layout and the solver. `structure` is the solver's
  /// structure. `is_reused`: Reset will be called. `pool`: threads that the solver uses too, which
  /// must outlive this; nullptr: it starts its own.
  SchurProblem(const AdjustmentProblem& problem, const ParameterLayout& layout,
               const SolveOptions& options, BlockStructure structure, LinearSolver* solver,
               bool is_reused = false, ThreadPool* pool = nullptr);
  SchurProblem(const SchurProblem&) = delete;
  SchurProblem& operator=(const SchurProblem&) = delete;

  /// Restarts at the problem's values (poses, camera parameters, points, measurements) and with the
  /// options' loss, after any of these changed. Results have the same bits as those of a new
  /// SchurProblem.
  void Reset(const SolveOptions& options);

  Linearization Linearize(double damping) override;
  NewtonResult SolveNewton(double eta) override;
  Candidate EvaluateNewtonStep() override;
  DoglegProducts Products() override;
  Candidate EvaluateDoglegStep(double a, double b) override;
  void Accept() override;
  double StateNorm() const override { return state_norm_; }
  std::optional<double> DegreesOfFreedom() const override { return degrees_of_freedom_; }
  /// False for conjugate gradients, which are not exact enough for a decrement.
  bool HasDecrement() const override { return !solver_->IsIterative(); }
  NewtonDecrement Decrement() override;
  double CostOfAll() override;
  void KeepPrevious() override;
  void ReturnToKept() override;
  bool HasBounds() const override { return !bounds_.empty(); }
  StepLine LineAlongStep() override;
  Candidate EvaluateAlongStep(double a) override;
  double SlopeAtCandidate() override;

  /// Number of observations in the solve, on this rank: those with free parameters.
  int64_t num_active_observations() const { return plan_.num_observations(); }
  /// Cost of all other observations, and of factors without free parameters. It is not included in
  /// Linearization::cost.
  double fixed_cost() const { return fixed_cost_; }
  /// Factors other than the observations.
  const CameraFactors& factors() const { return factors_; }
  /// Name of the instruction set of the kernels: "baseline", "avx2+fma" or "avx512".
  const char* instruction_set() const { return kernels_.name; }

  /// Observations of this rank that do not count at the state and have a held residual
  /// (factors/reprojection.h).
  int64_t num_held() const { return static_cast<int64_t>(x_->held.all().size()); }
  /// Cost of the factors of all ranks.
  double held_cost() const { return x_held_cost_; }
  /// Lets observations count that are in front of their cameras at the state, for a minimisation
  /// that starts there. Returns true if any rank has such observations.
  bool ReleaseHeld();

  /// S and its right-hand side at the last linearisation.
  BlockSystem& system() { return camera_sums().system; }
  /// Per column at the last linearisation: 1 if its number is on an active bound. Empty without
  /// bounds.
  const std::vector<uint8_t>& active_columns() const { return active_; }

  /// Inputs for other passes over the points, at the state and with the factors of the last
  /// linearisation.
  const SchurSetup& setup() const { return setup_; }
  const EliminationInput& input() const { return input_; }
  StateRecords records() const { return x_->records(); }
  const std::vector<HeldResidual>& held() const { return x_->held.all(); }

  /// Frees the memory needed for steps, mainly S. Call after the last step.
  void FreeSteps();

  /// Camera parameters and points (as in ProblemView) at the state.
  const CameraStates& cameras() const { return x_->cameras(); }
  LargeVector<double> Points() const { return x_->AllPoints(plan_); }

 private:
  EliminationInput WithPriors(EliminationInput input) const;
  void MeasureStart(const SolveOptions& options);
  /// Residuals minus free parameters, of all ranks; a point with one observation has as many of
  /// both. 0 with a robust loss.
  std::optional<double> CountDegreesOfFreedom(const SolveOptions& options) const;
  /// The residual of an observation at x; false if it cannot count.
  bool ResidualOf(const HeldResidual& held, double* residual) const;
  /// Calls visit(chunk index, thread) for all chunks on all threads, lower indices first, and
  /// done(thread) on each thread after its last chunk. If a call throws, the other threads end at
  /// their next chunk.
  template <typename Visit, typename Done>
  void ForChunks(const Visit& visit, const Done& done);
  template <typename Visit>
  void ForChunks(const Visit& visit);
  /// At a cache line, where the kernels' rows of 64 bytes are read fastest.
  double* Memory(int thread) { return AtCacheLine(memory_[thread].data()); }
  static constexpr uintptr_t kLine = 64;
  static double* AtCacheLine(double* memory) {
    const auto begin = reinterpret_cast<uintptr_t>(memory);
    return reinterpret_cast<double*>((begin + kLine - 1) / kLine * kLine);
  }
  /// CandidateSum over all chunks.
  struct CandidateTotal {
    DoubleDouble model_cost_change, cost, step_squared, state_squared;
  };
  static CandidateTotal Total(const std::vector<CandidateSum>& parts);
  /// The cost, and the norms of the points' gradient.
  struct PointSums {
    double cost = 0, gradient_squared = 0, gradient_max = 0, decrement = 0;
  };
  /// All sums at x, including those of factors: gradient and squared norms on all ranks, S on rank
  /// 0.
  PointSums SumUp(double damping, bool first, double factors_cost);
  /// Makes a pass over the chunks. Costs and points' gradients are summed over all ranks.
  PointSums SumChunks(double damping, bool first, double factors_cost);
  /// y = S x at the last linearisation, without S (implicit_product.cpp).
  void MultiplySchur(const double* x, double* y);
  void KeepRecords();
  /// Scales and damps the columns of the camera parameters.
  void DampCameras(double damping, bool first);
  /// Sums by the columns of the layout.
  CameraSums& camera_sums() { return setup_.part_sums != nullptr ? mapped_sums_ : sums_.sums(); }
  const std::vector<double>& gradient() { return camera_sums().gradient; }
  /// Removes the columns of numbers on active bounds from the normal equations.
  void HoldActive();
  /// Removes rounding errors along free similarities from q (newton_gauge.h). Returns the decrease
  /// of <q,q>.
  double TakeOutGauge();
  void MoveCameras(const std::vector<double>& step);
  /// Step of one camera parameter, projected onto its bounds.
  double ProjectedStep(size_t j, double step) const;
  /// Moves point number i of the candidate by point_step(i), for all i, and evaluates its cost.
  template <typename PointStep>
  CandidateTotal MovePoints(const PointStep& point_step);
  template <typename PointStep>
  void MovePoints(const Chunk& chunk, const PointStep& point_step, CandidateSum* sum);
  /// d^T J^T r along the last step, at a state.
  double SlopeAt(const State& state);
  /// `sum`: the sum of this rank.
  Candidate Finish(const std::vector<double>& step, CandidateTotal sum);

  const std::unique_ptr<ThreadPool> own_pool_;
  ThreadPool& pool_;
  SchurSetup setup_;
  const AdjustmentProblem& problem_ = setup_.problem;
  Communicator* const communicator_ = problem_.division.communicator;
  const ParameterLayout& layout_ = setup_.layout;
  const BlockStructure& structure_ = setup_.structure;
  const Kernels& kernels_ = setup_.kernels;
  const EliminationPlan& plan_ = setup_.plan;
  const Assembler& assembler_ = setup_.assembler;
  LinearSolver* const solver_;
  CameraFactors factors_;
  EliminationInput input_;
  std::vector<ArenaVector<double>> memory_;  ///< per thread
  State states_[2];
  State* x_ = &states_[0];
  State* candidate_ = &states_[1];
  // For MultiplySchur: the product per chunk, x per part, EliminationInput::kept_records.
  std::vector<std::vector<double>> product_parts_;
  std::vector<double> part_steps_;
  LargeVector<double> kept_records_;
  CameraStep step_;
  CameraStep other_step_;
  LargeVector<double> squared_scale_;  ///< per column of each point
  OrderedSums sums_;
  CameraSums mapped_sums_;              ///< with SchurSetup::part_sums only
  std::unique_ptr<SumGrid> grid_;       ///< nullptr: the sums need no grid
  std::vector<double> observed_norms_;  ///< ||J e_j||^2 at the last use of the grid
  bool has_camera_factors_ = false;     ///< true if any rank has them
  double x_cost_ = 0, candidate_cost_ = 0;
  std::vector<double> kind_costs_, candidate_kind_costs_;  ///< cost per kind of factors
  double x_held_cost_ = 0, candidate_held_cost_ = 0;
  std::vector<double> scale_;      ///< Jacobi scaling of the camera parameters' columns
  std::vector<double> d_squared_;  ///< D^2 of the camera parameters
  std::vector<double> newton_;     ///< camera parameters of the Newton direction
  std::vector<double> gradient_direction_;
  LargeVector<double> points_p_, points_q_;
  LargeVector<double> points_d_squared_;  ///< D^2 of the points; empty if the world is fixed
  int gauge_degrees_ = -1;  ///< degrees of freedom of the gauge, for doglegs; -1: not known yet
  std::vector<double> line_;
  LargeVector<double> points_line_;  ///< the last step, not projected
  DoglegProducts products_;
  const StateBounds bounds_;
  std::vector<uint8_t> active_;
  std::optional<double> degrees_of_freedom_;
  double point_decrement_ = 0;  ///< sum of g^T V'^-1 g over the points, at the last linearisation
  /// The state of KeepPrevious.
  struct Kept {
    State state;
    double cost, held_cost, norm;
    std::vector<double> kind_costs;
  };
  std::unique_ptr<Kept> kept_;
  double damping_ = 0;
  double state_norm_ = 0;
  double candidate_norm_ = 0;
  double fixed_cost_ = 0;
  bool scaled_ = false;
  bool moves_quaternions_ = false;  ///< in the gradient's maximum norm (linearize.cpp)
};

}  // namespace bundle
