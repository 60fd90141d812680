#include "core/solver/square_root_solver.h"

/// The Newton direction q of (J^T J + l D^2) q = -J^T r (minimize/least_squares.h) minimises
///
///   || [ J        ]     [ -r ] ||
///   || [ l^1/2 D  ] q - [  0 ] ||,
///
/// which Householder's reflections solve by [J; l^1/2 D] = Q R, R q = Q^T [-r; 0]. The error of q
/// is eps kappa(J) beside that of normal equations, eps kappa(J)^2, as long as the residual at the
/// solution is small (G. H. Golub, C. F. Van Loan: Matrix Computations, 5.3.8). Columns are scaled
/// by s_j = 1 / (1 + ||J e_j||) first. solver/block_qr.h has the factorisation.

#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/minimize/trust_region.h"
#include "core/model/problem_factors.h"
#include "core/prepare/prepare.h"
#include "core/solver/block_qr.h"

namespace bundle {
namespace {

using Eigen::VectorXd;
using Sparse = Eigen::SparseMatrix<double>;
using Values = std::vector<std::vector<double>>;

constexpr double kLeastDiagonal = 1e-6, kLargestDiagonal = 1e32;  // Ceres'
constexpr double kNoValue = std::numeric_limits<double>::quiet_NaN();

/// The free columns of a graph's Jacobian, and evaluations of it.
class GraphJacobian {
 public:
  explicit GraphJacobian(const FactorGraph& graph) : graph_(graph) {
    for (const Block& block : graph.blocks) {
      column_.emplace_back();
      for (int i = 0; i < block.retraction.tangent_size(); ++i) {
        column_.back().push_back(block.IsHeld(i) ? -1 : num_columns_++);
      }
    }
    for (const auto& factor : graph.factors) num_rows_ += factor->num_residuals();
  }

  /// Free columns of each variable.
  std::vector<int> sizes() const {
    std::vector<int> sizes;
    for (const Block& block : graph_.blocks) sizes.push_back(block.NumFree());
    return sizes;
  }
  /// The free columns of each factor's J, times a scale of each column, beside -r.
  std::vector<RowBlock> Rows(const Sparse& jacobian, const VectorXd& residual,
                             const VectorXd& scale) const {
    std::vector<RowBlock> blocks;
    const Eigen::SparseMatrix<double, Eigen::RowMajor> by_rows = jacobian * scale.asDiagonal();
    int row = 0;
    for (const auto& factor : graph_.factors) {
      RowBlock block;
      std::vector<int> columns;
      for (const int b : factor->blocks()) {
        if (graph_.blocks[b].NumFree() == 0) continue;
        block.variables.push_back(b);
        for (const int column : column_[b]) {
          if (column >= 0) columns.push_back(column);
        }
      }
      const int rows = factor->num_residuals();
      block.matrix = Eigen::MatrixXd::Zero(rows, static_cast<Eigen::Index>(columns.size()) + 1);
      for (int k = 0; k < rows; ++k) {
        for (size_t c = 0; c < columns.size(); ++c) {
          block.matrix(k, static_cast<Eigen::Index>(c)) = by_rows.coeff(row + k, columns[c]);
        }
      }
      block.matrix.rightCols(1) = -residual.segment(row, rows);
      row += rows;
      blocks.push_back(std::move(block));
    }
    return blocks;
  }

  int num_columns() const { return num_columns_; }
  int num_rows() const { return num_rows_; }

  /// Cost at the values, NaN where a factor has none; J and r, losses applied, if both are wanted.
  double Evaluate(const Values& values, VectorXd* residual, Sparse* jacobian) const {
    std::vector<Eigen::Triplet<double>> entries;
    std::vector<double> r, j;
    if (residual != nullptr) residual->resize(num_rows_);
    double cost = 0;
    int row = 0;
    for (const auto& factor : graph_.factors) {
      const int rows = factor->num_residuals();
      r.assign(rows, 0);
      if (!EvaluateFactor(*factor, values, residual == nullptr ? nullptr : &j, &r)) return kNoValue;
      const int width = residual == nullptr ? 0 : static_cast<int>(j.size()) / rows;
      cost += ApplyLoss(*factor, width, r.data(), residual == nullptr ? nullptr : j.data());
      if (residual != nullptr) {
        int first = 0;
        for (const int b : factor->blocks()) {
          for (const int column : column_[b]) {
            for (int k = 0; column >= 0 && k < rows; ++k) {
              entries.emplace_back(row + k, column, j[k * width + first]);
            }
            ++first;
          }
        }
        std::copy(r.begin(), r.end(), residual->data() + row);
      }
      row += rows;
    }
    if (jacobian != nullptr) {
      jacobian->resize(num_rows_, num_columns_);
      jacobian->setFromTriplets(entries.begin(), entries.end());
      jacobian->makeCompressed();
    }
    return cost;
  }

  /// to = from moved by the step of the free columns.
  void Move(const Values& from, const VectorXd& step, Values* to) const {
    std::vector<double> delta;
    for (size_t b = 0; b < column_.size(); ++b) {
      delta.clear();
      for (const int column : column_[b]) delta.push_back(column < 0 ? 0 : step[column]);
      graph_.blocks[b].retraction.Plus(from[b].data(), delta.data(), (*to)[b].data());
    }
  }

  /// ||x|| over the variables that are not held as a whole.
  double Norm(const Values& values) const {
    double sum = 0;
    for (size_t b = 0; b < values.size(); ++b) {
      if (graph_.blocks[b].NumFree() == 0) continue;
      for (const double value : values[b]) sum += value * value;
    }
    return std::sqrt(sum);
  }

 private:
  /// The factor's J by rows, its variables one after the other, in `j`.
  static bool EvaluateFactor(const Factor& factor, const Values& values, std::vector<double>* j,
                             std::vector<double>* r) {
    std::vector<const double*> pointers;
    for (const int b : factor.blocks()) pointers.push_back(values[b].data());
    std::vector<std::vector<double>> blocks;
    std::vector<double*> into;
    int width = 0;
    for (const Retraction& retraction : factor.retractions()) {
      blocks.emplace_back(r->size() * retraction.tangent_size());
      into.push_back(blocks.back().data());
      width += retraction.tangent_size();
    }
    const bool has_value =
        factor.Evaluate(pointers.data(), r->data(), j == nullptr ? nullptr : into.data());
    const auto is_finite = [](double value) { return std::isfinite(value); };
    if (!has_value || !std::all_of(r->begin(), r->end(), is_finite)) return false;
    if (j == nullptr) return true;
    j->resize(r->size() * width);
    int first = 0;
    for (size_t b = 0; b < blocks.size(); ++b) {
      const int size = factor.retractions()[b].tangent_size();
      for (size_t k = 0; k < r->size(); ++k) {
        std::copy_n(blocks[b].data() + k * size, size, j->data() + k * width + first);
      }
      first += size;
    }
    return std::all_of(j->begin(), j->end(), is_finite);
  }

  const FactorGraph& graph_;
  std::vector<std::vector<int>> column_;  ///< of each coordinate of each variable; -1: held
  int num_columns_ = 0, num_rows_ = 0;
};

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
      result.status = NewtonResult::Status::kFailure;
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
      const double norm = jacobian_.col(c).norm();
      if (is_first) scale_[c] = 1 / (1 + norm);
      const double s = scale_[c];
      diagonal_[c] =
          std::sqrt(std::clamp(s * s * norm * norm, kLeastDiagonal, kLargestDiagonal)) / s;
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
  bool is_current_ = false;  ///< what follows is of values_
  double cost_ = 0, damping_ = 0;
  VectorXd residual_, gradient_, scale_, diagonal_, newton_, steepest_;
  Sparse jacobian_;
  std::unique_ptr<BlockQr> qr_;
};

void Summarize(const SquareRootProblem& problem, const FactorGraph& graph,
               const SolveOptions& options, const MinimizerSummary& minimum,
               SolveSummary* summary) {
  double least = minimum.iterations.empty() ? -1 : minimum.iterations.front().cost;
  summary->initial_cost = least;
  for (const IterationRecord& record : minimum.iterations) {
    if (record.step_is_successful) least = std::min(least, record.cost);
  }
  summary->final_cost = least;
  summary->fixed_cost = 0;
  int blocks = 0, numbers = 0;
  for (const Block& block : graph.blocks) {
    if (block.NumFree() == 0) continue;
    ++blocks;
    numbers += static_cast<int>(block.value.size());
  }
  summary->num_parameter_blocks = summary->num_parameter_blocks_reduced = blocks;
  summary->num_parameters = summary->num_parameters_reduced = numbers;
  const auto factors = static_cast<int>(graph.factors.size());
  summary->num_residual_blocks = summary->num_residual_blocks_reduced = factors;
  const int rows = problem.jacobian().num_rows();
  summary->num_residuals = summary->num_residuals_reduced = rows;
  const bool dogleg =
      options.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt;
  summary->trust_region_strategy_type = dogleg ? "DOGLEG" : "LEVENBERG_MARQUARDT";
  summary->dogleg_type = options.trust_region_strategy_type == TrustRegionStrategy::kSubspaceDogleg
                             ? "SUBSPACE_DOGLEG"
                             : "TRADITIONAL_DOGLEG";
  summary->linear_solver_type_given = UpperName(options.linear_solver_type, kLinearSolverTypes);
  summary->linear_solver_type_used = "SPARSE_QR";
  summary->linear_solver_ordering_given = summary->linear_solver_ordering_used = {blocks};
  summary->preconditioner_type_given = summary->preconditioner_type_used = "JACOBI";
  summary->sparse_linear_algebra_library_type = "BLOCK_QR";
  summary->dense_linear_algebra_library_type = "EIGEN";
  summary->num_threads_given = EffectiveNumThreads(options.num_threads);
  summary->num_threads_used = 1;
  summary->residual_evaluation_time_in_seconds = minimum.candidate_time_in_seconds;
  summary->jacobian_evaluation_time_in_seconds = minimum.linearization_time_in_seconds;
  summary->linear_solver_time_in_seconds = minimum.solve_time_in_seconds;
  summary->num_residual_evaluations = minimum.num_candidates;
  summary->num_jacobian_evaluations = minimum.num_linearizations;
  summary->num_linear_solves = minimum.num_linear_solves;
  summary->termination_type = minimum.termination_type;
  summary->message = minimum.message;
  summary->is_solution_usable = minimum.termination_type != "FAILURE";
  summary->interrupted = minimum.interrupted;
  summary->num_successful_steps = minimum.num_successful_steps;
  summary->num_unsuccessful_steps = minimum.num_unsuccessful_steps;
  summary->backend_given = UpperName(options.backend, kBackends);
  summary->backend_used = UpperName(Backend::kFused, kBackends);
}

/// A power iteration's estimate of the largest eigenvalue of `multiply`, from a fixed start.
template <typename Multiply>
double LargestEigenvalue(int n, const Multiply& multiply) {
  constexpr int kMaxSteps = 60;
  VectorXd x(n);
  for (int i = 0; i < n; ++i) x[i] = 1 + 0.5 * std::sin(1.7 * i + 0.3);
  x.normalize();
  double value = 0;
  for (int k = 0; k < kMaxSteps; ++k) {
    x = multiply(x);
    const double norm = x.norm();
    if (!(norm > 0) || !std::isfinite(norm)) return norm;
    x /= norm;
    const bool is_settled = std::abs(norm - value) <= 1e-3 * norm;
    value = norm;
    if (is_settled && k > 3) break;
  }
  return value;
}

}  // namespace

JacobianConditioning EstimateConditioning(const FactorGraph& graph) {
  ValidateGraph(graph);
  const GraphJacobian evaluation(graph);
  const int n = evaluation.num_columns();
  if (n == 0) throw InputError("factor graph: expected free coordinates, found none");
  Values values;
  for (const Block& block : graph.blocks) values.push_back(block.value);
  VectorXd residual;
  Sparse jacobian;
  if (!std::isfinite(evaluation.Evaluate(values, &residual, &jacobian))) {
    throw InputError("factor graph: a factor has no value, or no finite one");
  }
  VectorXd scale(n);
  for (int c = 0; c < n; ++c) {
    const double norm = jacobian.col(c).norm();
    scale[c] = norm > 0 ? 1 / norm : 1;
  }
  std::vector<RowBlock> rows = evaluation.Rows(jacobian, residual, scale);
  BlockQr qr(evaluation.sizes(), rows);
  qr.Factorize(std::move(rows));
  jacobian = jacobian * scale.asDiagonal();
  JacobianConditioning result;
  result.num_columns = n;
  const double rounding = 16 * n * std::numeric_limits<double>::epsilon();
  result.rank = static_cast<int>((qr.Pivots().array() > rounding).count());
  result.max_singular_value = std::sqrt(LargestEigenvalue(
      n, [&](const VectorXd& x) { return VectorXd(jacobian.transpose() * (jacobian * x)); }));
  if (result.rank < n) return result;
  const double inverse = LargestEigenvalue(n, [&](const VectorXd& x) { return qr.SolveNormal(x); });
  result.min_singular_value = std::isfinite(inverse) && inverse > 0 ? 1 / std::sqrt(inverse) : 0;
  return result;
}

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
    throw InputError("square_root: expected free coordinates, found none");
  }
  const double setup_time = time.seconds();
  const Stopwatch solve_time;
  MinimizerSummary minimum = Minimize(options, progress, &problem);
  GraphOutput output;
  output.solve_time_in_seconds = solve_time.seconds();
  Summarize(problem, graph, options, minimum, &output.summary);
  output.summary.preprocessor_time_in_seconds = setup_time;
  output.summary.minimizer_time_in_seconds = output.solve_time_in_seconds;
  output.summary.postprocessor_time_in_seconds = 0;
  output.summary.total_time_in_seconds = time.seconds();
  output.iterations = std::move(minimum.iterations);
  output.values = problem.values();
  output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
  return output;
}

}  // namespace bundle
