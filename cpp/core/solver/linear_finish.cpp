#include "core/solver/linear_finish.h"

/// A trust region method ends when another step would hardly change the cost. With the default
/// tolerance and damping, this is some 1e-4 standard deviations before the minimum. With curved
/// residuals this does not matter, because their linearisation is not more accurate. With linear
/// residuals it gives a wrong digit, although the minimum is one step away. A graph is considered
/// linear if
///
///   its first step lowered the cost as the model predicted, to rounding (not required where
///   there are bounds, which cut steps), and
///   its Jacobian is the same, to rounding, before and after the step q of min ||J q + r||.
///
/// q comes from a QR factorisation, J S = Q R with columns of norm 1 (S). It is refined with R^T R
/// as long as the gradient is at least halved. The cost cannot be used as a measure any more,
/// because it changes by the square of the remaining step. Directions that no factor determines are
/// damped by l = 1e-12, as are coordinates at a bound that the gradient pushes outwards.

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "core/interface/summary.h"
#include "core/solver/block_qr.h"
#include "core/solver/graph_jacobian.h"

namespace bundle {
namespace {

using Eigen::VectorXd;
using Sparse = GraphJacobian::Sparse;
using Values = GraphJacobian::Values;

constexpr int kMostSteps = 5;
constexpr double kAsPromised = 1e-6;
constexpr double kSameJacobian = 1e-12;
constexpr double kRootOfDamping = 1e-6;
constexpr double kRounding = std::numeric_limits<double>::epsilon();

/// Only residuals of positions and angles are linear.
bool MayBeLinear(const FactorGraph& graph) {
  for (const Block& block : graph.blocks) {
    const Manifold manifold = block.retraction.manifold();
    const bool is_flat = manifold == Manifold::kEuclidean || manifold == Manifold::kSo2;
    if (!is_flat && block.NumFree() > 0) return false;
  }
  return std::all_of(graph.factors.begin(), graph.factors.end(),
                     [](const auto& factor) { return factor->loss() == LossType::kTrivial; });
}

/// Also true if bounds have cut steps, because predicted decreases are then meaningless.
bool FirstStepWasPromised(const FactorGraph& graph,
                          const std::vector<IterationRecord>& iterations) {
  for (const Block& block : graph.blocks) {
    if (!block.lower.empty()) return true;
  }
  for (const IterationRecord& record : iterations) {
    if (record.iteration == 0 || !record.step_is_successful) continue;
    // The cost before the step has a rounding error.
    const double noise = 100 * kRounding * (record.cost + std::abs(record.cost_change)) /
                         std::abs(record.cost_change);
    return std::abs(record.relative_decrease - 1) <= kAsPromised + noise;
  }
  return true;
}

/// The graph, linearised at some values.
struct Place {
  Values values;
  double cost = 0;
  VectorXd residual;
  Sparse jacobian;
  VectorXd gradient;  ///< for columns of norm 1; zero at active bounds
};

class LinearFinish {
 public:
  explicit LinearFinish(const FactorGraph& graph) : graph_(graph), evaluation_(graph) {}

  /// Takes steps as long as each halves the gradient; false if the first does not, or the graph is
  /// not linear.
  bool Run(const Values& values) {
    if (!Evaluate(values, &at_)) return false;
    scale_.resize(evaluation_.num_columns());
    for (Eigen::Index c = 0; c < scale_.size(); ++c) {
      const double norm = at_.jacobian.col(c).norm();
      scale_[c] = norm > 0 ? 1 / norm : 1;
    }
    SetGradient(&at_);
    HoldAtBounds();
    Factorize(0);
    const double rounding = 16 * static_cast<double>(scale_.size()) * kRounding;
    if (!(qr_->Pivots().minCoeff() > rounding)) Factorize(kRootOfDamping);
    VectorXd step = scale_.cwiseProduct(qr_->Solve());
    for (int k = 0; k < kMostSteps && step.allFinite(); ++k) {
      Place next;
      next.values = at_.values;
      evaluation_.Move(at_.values, step, &next.values);
      if (!IsWithinBounds(next.values) || !Evaluate(next.values, &next)) break;
      SetGradient(&next);
      const Sparse change = next.jacobian - at_.jacobian;
      for (Eigen::Index c = 0; k == 0 && c < scale_.size(); ++c) {
        if (change.col(c).norm() * scale_[c] > kSameJacobian) return false;
      }
      if (!(next.gradient.lpNorm<Eigen::Infinity>() <
            0.5 * at_.gradient.lpNorm<Eigen::Infinity>())) {
        break;
      }
      step_norm_ += step.norm();
      at_ = std::move(next);
      step = -scale_.cwiseProduct(qr_->SolveNormal(at_.gradient));
    }
    return step_norm_ > 0;
  }

  const Place& at() const { return at_; }
  double step_norm() const { return step_norm_; }
  double gradient_max_norm() const {
    return (at_.jacobian.transpose() * at_.residual).lpNorm<Eigen::Infinity>();
  }

 private:
  bool Evaluate(const Values& values, Place* place) const {
    place->values = values;
    place->cost = evaluation_.Evaluate(values, &place->residual, &place->jacobian);
    return std::isfinite(place->cost);
  }

  void SetGradient(Place* place) const {
    place->gradient = scale_.cwiseProduct(place->jacobian.transpose() * place->residual);
    for (const Eigen::Index c : held_) place->gradient[c] = 0;
  }

  template <typename Visit>
  void ForBounds(const Values& values, const Visit& visit) const {
    Eigen::Index column = 0;
    for (size_t b = 0; b < graph_.blocks.size(); ++b) {
      const Block& block = graph_.blocks[b];
      for (int i = 0; i < block.retraction.tangent_size(); ++i) {
        if (block.IsHeld(i)) continue;
        if (!block.lower.empty()) visit(column, values[b][i], block.lower[i], block.upper[i]);
        ++column;
      }
    }
  }

  void HoldAtBounds() {
    ForBounds(at_.values, [&](Eigen::Index column, double value, double lower, double upper) {
      const double slope = at_.gradient[column];
      if ((value <= lower && slope > 0) || (value >= upper && slope < 0)) held_.push_back(column);
    });
    for (const Eigen::Index c : held_) at_.gradient[c] = 0;
  }

  bool IsWithinBounds(const Values& values) const {
    bool is_within = true;
    ForBounds(values, [&](Eigen::Index /*column*/, double value, double lower, double upper) {
      is_within = is_within && lower <= value && value <= upper;
    });
    return is_within;
  }

  /// With rows `root` for all columns, and 1 for the constant ones.
  void Factorize(double root) {
    VectorXd scale = scale_;
    VectorXd damping = VectorXd::Constant(scale.size(), root);
    for (const Eigen::Index c : held_) scale[c] = 0, damping[c] = 1;
    std::vector<RowBlock> rows = evaluation_.Rows(at_.jacobian, at_.residual, scale);
    const std::vector<int> sizes = evaluation_.sizes();
    Eigen::Index first = 0;
    for (size_t v = 0; v < sizes.size(); ++v) {
      if (sizes[v] == 0) continue;
      RowBlock damped{{static_cast<int>(v)}, Eigen::MatrixXd::Zero(sizes[v], sizes[v] + 1)};
      damped.matrix.leftCols(sizes[v]).diagonal() = damping.segment(first, sizes[v]);
      first += sizes[v];
      if (!damped.matrix.isZero(0)) rows.push_back(std::move(damped));
    }
    qr_ = std::make_unique<BlockQr>(sizes, rows);
    qr_->Factorize(std::move(rows));
  }

  const FactorGraph& graph_;
  const GraphJacobian evaluation_;
  std::unique_ptr<BlockQr> qr_;
  std::vector<Eigen::Index> held_;
  VectorXd scale_;
  Place at_;
  double step_norm_ = 0;
};

}  // namespace

void FinishLinearGraph(const FactorGraph& graph, GraphOutput* output) {
  SolveSummary& summary = output->summary;
  if (summary.termination_type != "CONVERGENCE" || summary.interrupted ||
      output->iterations.empty() || !MayBeLinear(graph) ||
      !FirstStepWasPromised(graph, output->iterations)) {
    return;
  }
  const Stopwatch time;
  LinearFinish finish(graph);
  if (!finish.Run(output->values)) return;
  const Place& at = finish.at();
  IterationRecord record = output->iterations.back();
  ++record.iteration;
  record.cost_change = record.cost - at.cost;
  record.cost = summary.final_cost = at.cost;
  record.gradient_max_norm = finish.gradient_max_norm();
  record.step_norm = finish.step_norm();
  record.relative_decrease = 1;
  record.linear_solver_iterations = 1;
  record.step_is_successful = true;
  record.iteration_time_in_seconds = time.seconds();
  record.cumulative_time_in_seconds += time.seconds();
  output->iterations.push_back(record);
  ++summary.num_successful_steps;
  output->values = at.values;
  output->solve_time_in_seconds += time.seconds();
}

}  // namespace bundle
