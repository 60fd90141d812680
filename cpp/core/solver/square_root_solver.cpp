#include "core/solver/square_root_solver.h"

/// The Newton direction q of (J^T J + l D^2) q = -J^T r (minimize/least_squares.h) minimises
///
///   || [ J        ]     [ -r ] ||
///   || [ l^1/2 D  ] q - [  0 ] ||,
///
/// which Householder reflections solve by [J; l^1/2 D] = Q R, R q = Q^T [-r; 0]. The error of q is
/// eps kappa(J) if the residual at the solution is small; with normal equations it is eps
/// kappa(J)^2 (G. H. Golub, C. F. Van Loan: Matrix Computations, 5.3.8). Columns are scaled by s_j
/// = 1 / (1 + ||J e_j||) first. solver/block_qr.h has the factorisation.

#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/checking/check_solution.h"
#include "core/error.h"
#include "core/minimize/damping.h"
#include "core/minimize/trust_region.h"
#include "core/solver/block_qr.h"
#include "core/solver/graph_jacobian.h"
#include "core/solver/summarize_fused.h"

namespace bundle {
namespace {

using Eigen::VectorXd;
using Sparse = GraphJacobian::Sparse;
using Values = GraphJacobian::Values;

class SquareRootProblem final : public LeastSquares {
 public:
  explicit SquareRootProblem(const FactorGraph& graph) : evaluation_(graph) {
    for (const Block& block : graph.blocks) values_.push_back(block.value);
    candidate_ = values_;
  }

  const Values& values() const { return values_; }
  const GraphJacobian& jacobian() const { return evaluation_; }

  Linearization Linearize(double damping) override {
    Linearization result;
    damping_ = damping;
    if (!is_current_) cost_ = evaluation_.Evaluate(values_, &residual_, &jacobian_);
    result.cost = cost_;
    result.is_finite = std::isfinite(cost_);
    if (!result.is_finite) return result;
    if (!is_current_) {
      gradient_ = jacobian_.transpose() * residual_;
      SetDiagonal();
    }
    is_current_ = true;
    result.gradient_norm = gradient_.norm();
    result.gradient_max_norm = gradient_.size() == 0 ? 0 : gradient_.cwiseAbs().maxCoeff();
    return result;
  }

  NewtonResult SolveNewton(double /*eta*/) override {
    std::vector<RowBlock> rows = evaluation_.Rows(jacobian_, residual_, scale_);
    const std::vector<int> sizes = evaluation_.sizes();
    int first = 0;
    for (size_t v = 0; v < sizes.size(); ++v) {
      if (sizes[v] == 0) continue;
      RowBlock damped{{static_cast<int>(v)}, Eigen::MatrixXd::Zero(sizes[v], sizes[v] + 1)};
      for (int c = 0; c < sizes[v]; ++c, ++first) {
        damped.matrix(c, c) = std::sqrt(damping_) * diagonal_[first] * scale_[first];
      }
      rows.push_back(std::move(damped));
    }
    if (!qr_) qr_ = std::make_unique<BlockQr>(sizes, rows);
    qr_->Factorize(std::move(rows));
    newton_ = scale_.cwiseProduct(qr_->Solve());
    NewtonResult result;
    if (!newton_.allFinite()) {
      result.status = LinearStatus::kFailure;
      result.message = "The QR factorisation of the Jacobian failed.";
    }
    result.num_iterations = 1;
    return result;
  }

  Candidate EvaluateNewtonStep() override { return EvaluateStep(newton_); }

  DoglegProducts Products() override {
    const VectorXd square = diagonal_.cwiseAbs2();
    steepest_ = gradient_.cwiseQuotient(square);
    const VectorXd jp = jacobian_ * steepest_, jq = jacobian_ * newton_;
    DoglegProducts result;
    result.d_pp = steepest_.dot(gradient_);
    result.d_pq = newton_.dot(gradient_);
    result.d_qq = newton_.dot(square.cwiseProduct(newton_));
    result.j_pp = jp.squaredNorm();
    result.j_pq = jp.dot(jq);
    result.j_qq = jq.squaredNorm();
    return result;
  }

  Candidate EvaluateDoglegStep(double a, double b) override {
    return EvaluateStep(a * steepest_ + b * newton_);
  }

  void Accept() override {
    std::swap(values_, candidate_);
    is_current_ = false;
  }

  double StateNorm() const override { return evaluation_.Norm(values_); }

 private:
  void SetDiagonal() {
    const auto n = gradient_.size();
    const bool is_first = scale_.size() != n;
    if (is_first) scale_.resize(n);
    diagonal_.resize(n);
    for (Eigen::Index c = 0; c < n; ++c) {
      const double squared_norm = jacobian_.col(c).squaredNorm();
      if (is_first) scale_[c] = JacobiScale(squared_norm);
      diagonal_[c] = std::sqrt(SquaredDamping(squared_norm, scale_[c]));
    }
  }

  Candidate EvaluateStep(const VectorXd& step) {
    Candidate result;
    const VectorXd change = jacobian_ * step;
    result.model_cost_change = -change.dot(residual_ + 0.5 * change);
    result.step_norm = step.norm();
    evaluation_.Move(values_, step, &candidate_);
    result.cost = evaluation_.Evaluate(candidate_, nullptr, nullptr);
    return result;
  }

  const GraphJacobian evaluation_;
  Values values_, candidate_;
  bool is_current_ = false;  ///< true if the members below belong to values_
  double cost_ = 0, damping_ = 0;
  VectorXd residual_, gradient_, scale_, diagonal_, newton_, steepest_;
  Sparse jacobian_;
  std::unique_ptr<BlockQr> qr_;
};

void SummarizeSquareRoot(const SquareRootProblem& problem, const FactorGraph& graph,
                         SolveOptions options, const MinimizerSummary& minimum,
                         SolveSummary* summary) {
  int blocks = 0, numbers = 0;
  for (const Block& block : graph.blocks) {
    if (block.NumFree() == 0) continue;
    ++blocks;
    numbers += static_cast<int>(block.value.size());
  }
  options.num_threads = EffectiveNumThreads(options.num_threads);
  SummarizeChoices(options, summary);
  SummarizeMinimum(minimum, 0, Counted::kAccepted, summary);
  SetSizes(blocks, numbers, static_cast<int64_t>(graph.factors.size()),
           problem.jacobian().num_rows(), summary);
  summary->linear_solver_type_used = "SPARSE_QR";
  summary->linear_solver_ordering_given = summary->linear_solver_ordering_used = {blocks};
  summary->sparse_linear_algebra_library_type = "BLOCK_QR";
  summary->dense_linear_algebra_library_type = "EIGEN";
  summary->num_threads_used = 1;
  summary->backend_given = UpperName(options.backend, kBackends);
  summary->backend_used = UpperName(Backend::kFused, kBackends);
}

}  // namespace

GraphOutput SolveGraphBySquareRoot(const FactorGraph& graph, const SolveOptions& options,
                                   const ProgressCallback& progress) {
  const Stopwatch time;
  ValidateGraph(graph);
  ThrowIfInterrupted();
  for (const Block& block : graph.blocks) {
    if (block.lower.empty()) continue;
    throw InputError("square_root: expected no bounds, found those of " + block.name);
  }
  SquareRootProblem problem(graph);
  if (problem.jacobian().num_columns() == 0) {
    throw InputError("square_root: expected free coordinates, found 0");
  }
  const double setup_time = time.seconds();
  const Stopwatch solve_time;
  MinimizerSummary minimum = Minimize(options, progress, &problem);
  GraphOutput output;
  output.solve_time_in_seconds = solve_time.seconds();
  SummarizeSquareRoot(problem, graph, options, minimum, &output.summary);
  output.summary.preprocessor_time_in_seconds = setup_time;
  output.summary.minimizer_time_in_seconds = output.solve_time_in_seconds;
  output.summary.postprocessor_time_in_seconds = 0;
  output.summary.total_time_in_seconds = time.seconds();
  output.iterations = std::move(minimum.iterations);
  JudgeEnd(/*has_bounds=*/false, options.function_tolerance, &output);
  output.values = problem.values();
  output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
  return output;
}

}  // namespace bundle
