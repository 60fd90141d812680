#include "core/ceres/ceres_graph.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "core/ceres/gradient_check.h"
#include "core/ceres/losses.h"
#include "core/error.h"
#include "core/factors/factor.h"
#include "core/parallel/thread_pool.h"
#include "core/words.h"

namespace bundle {

namespace {

void ExpectSize(const std::string& name, int found, int expected) {
  if (found == expected) return;
  throw InputError("manifolds: " + name + " expects a block of " + Counted(expected, "number") +
                   ", found " + std::to_string(found));
}

void CheckSubset(int size, const std::vector<int>& constant) {
  const std::set<int> distinct(constant.begin(), constant.end());
  if (distinct.size() != constant.size()) {
    throw InputError("manifolds: subset names an entry twice");
  }
  if (static_cast<int>(distinct.size()) >= size) {
    throw InputError("manifolds: subset expects at least one free entry, found 0 of " +
                     Counted(size, "number"));
  }
  if (distinct.empty() || *distinct.begin() < 0 || *distinct.rbegin() >= size) {
    throw InputError("manifolds: subset expects entries from 0 to " + std::to_string(size - 1));
  }
}

}  // namespace

std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant) {
  if (name == "euclidean") return nullptr;
  if (name == "quaternion_wxyz") {
    ExpectSize(name, size, 4);
    return std::make_unique<ceres::QuaternionManifold>();
  }
  if (name == "quaternion_xyzw") {
    ExpectSize(name, size, 4);
    return std::make_unique<ceres::EigenQuaternionManifold>();
  }
  if (name == "se3") {
    ExpectSize(name, size, 7);
    return std::make_unique<
        ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>>();
  }
  if (name == "sphere") {
    if (size < 2) throw InputError("manifolds: sphere expects a block of at least 2 numbers");
    return std::make_unique<ceres::SphereManifold<ceres::DYNAMIC>>(size);
  }
  if (name == "subset") {
    CheckSubset(size, constant);
    return std::make_unique<ceres::SubsetManifold>(size, constant);
  }
  throw InputError(
      "manifolds: expected euclidean, angle_axis, quaternion_wxyz, quaternion_xyzw, "
      "se3, sphere or subset, found '" +
      name + "'");
}

namespace {

class ChartedCost final : public ceres::CostFunction {
 public:
  ChartedCost(ChartedFactor factor, const CameraStates& states, Abandonment* abandonment)
      : factor_(std::move(factor)), states_(states), abandonment_(abandonment) {
    set_num_residuals(factor_.num_residuals());
    const std::vector<int>& begin = factor_.column_begin();
    for (size_t b = 0; b + 1 < begin.size(); ++b) {
      mutable_parameter_block_sizes()->push_back(begin[b + 1] - begin[b]);
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    return abandonment_->Guard([&] {
      if (jacobians == nullptr) return factor_.Evaluate(states_, parameters, residuals, nullptr);
      const int rows = num_residuals(), columns = factor_.num_columns();
      std::vector<double> jacobian(static_cast<size_t>(rows) * columns);
      if (!factor_.Evaluate(states_, parameters, residuals, jacobian.data())) return false;
      const std::vector<int>& begin = factor_.column_begin();
      for (size_t b = 0; b + 1 < begin.size(); ++b) {
        if (jacobians[b] == nullptr) continue;
        const int size = begin[b + 1] - begin[b];
        for (int r = 0; r < rows; ++r) {
          std::copy_n(jacobian.data() + r * columns + begin[b], size, jacobians[b] + r * size);
        }
      }
      return true;
    });
  }

 private:
  const ChartedFactor factor_;
  const CameraStates& states_;
  Abandonment* const abandonment_;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> MakeFactorCost(ChartedFactor factor,
                                                    const CameraStates& states,
                                                    Abandonment* abandonment) {
  return std::make_unique<ChartedCost>(std::move(factor), states, abandonment);
}

class CeresGraph::Cost final : public ceres::CostFunction {
 public:
  Cost(const Factor& factor, const CeresGraph& graph) : factor_(factor), graph_(graph) {
    set_num_residuals(factor.num_residuals());
    for (const Retraction& retraction : factor.retractions()) {
      mutable_parameter_block_sizes()->push_back(retraction.ambient_size());
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!graph_.Evaluate(factor_, parameters, residuals, jacobians)) return false;
    const int rows = num_residuals();
    if (!std::all_of(residuals, residuals + rows, [](double r) { return std::isfinite(r); })) {
      return false;
    }
    for (size_t b = 0; jacobians != nullptr && b < factor_.retractions().size(); ++b) {
      if (jacobians[b] != nullptr) Widen(rows, factor_.retractions()[b], jacobians[b]);
    }
    return true;
  }

 private:
  /// Widens J to [J 0] in place, from the last row on, so that no row is overwritten before it is
  /// read.
  static void Widen(int rows, const Retraction& retraction, double* jacobian) {
    const int narrow = retraction.tangent_size(), wide = retraction.ambient_size();
    if (narrow == wide) return;
    for (int r = rows - 1; r >= 0; --r) {
      std::copy_backward(jacobian + r * narrow, jacobian + (r + 1) * narrow,
                         jacobian + r * wide + narrow);
      std::fill(jacobian + r * wide + narrow, jacobian + (r + 1) * wide, 0.0);
    }
  }

  const Factor& factor_;
  const CeresGraph& graph_;
};

class CeresGraph::Watch final : public ceres::EvaluationCallback {
 public:
  explicit Watch(CeresGraph* graph) : graph_(graph) {}

  void PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) override {
    // As in a solve of a problem: Ceres asks for derivatives at a new point only at the start.
    graph_->step_lengths_.Evaluate(evaluate_jacobians && !(new_evaluation_point && has_start_));
    has_start_ = has_start_ || evaluate_jacobians;
    if (evaluate_jacobians) {
      graph_->active_bounds_.Find();
    } else if (InterruptionRequested()) {
      graph_->abandonment_.happened.store(true);
    }
  }

 private:
  CeresGraph* graph_;
  bool has_start_ = false;
};

class CeresGraph::BlockManifold final : public ceres::Manifold {
 public:
  BlockManifold(const Block& block, bool all_free) : retraction_(block.retraction) {
    for (int i = 0; i < retraction_.tangent_size(); ++i) {
      if (all_free || !block.IsHeld(i)) free_.push_back(i);
    }
  }

  int AmbientSize() const override { return retraction_.ambient_size(); }
  int TangentSize() const override { return static_cast<int>(free_.size()); }

  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    std::vector<double> full(retraction_.tangent_size(), 0.0);
    for (size_t k = 0; k < free_.size(); ++k) full[free_[k]] = delta[k];
    retraction_.Plus(x, full.data(), x_plus_delta);
    return true;
  }

  bool PlusJacobian(const double* /*x*/, double* jacobian) const override {
    std::fill(jacobian, jacobian + AmbientSize() * TangentSize(), 0.0);
    for (size_t k = 0; k < free_.size(); ++k) jacobian[free_[k] * TangentSize() + k] = 1;
    return true;
  }

  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    std::vector<double> full(retraction_.tangent_size());
    retraction_.Local(x, y, full.data());
    for (size_t k = 0; k < free_.size(); ++k) y_minus_x[k] = full[free_[k]];
    return true;
  }

  bool MinusJacobian(const double* /*x*/, double* jacobian) const override {
    std::fill(jacobian, jacobian + AmbientSize() * TangentSize(), 0.0);
    for (size_t k = 0; k < free_.size(); ++k) jacobian[k * AmbientSize() + free_[k]] = 1;
    return true;
  }

 private:
  Retraction retraction_;
  std::vector<int> free_;
};

CeresGraph::CeresGraph(const FactorGraph& graph, bool all_free)
    : graph_(graph), watch_(std::make_unique<Watch>(this)) {
  ceres::Problem::Options options;
  options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.disable_all_safety_checks = true;  // the graph is valid
  options.evaluation_callback = watch_.get();
  problem_ = std::make_unique<ceres::Problem>(options);
  for (const Block& block : graph.blocks) {
    values_.push_back(CheckedValue(block.name, block.retraction, block.value));
    double* data = values_.back().data();
    const int size = block.retraction.ambient_size();
    step_lengths_.Add(data, size);
    const bool moves_as_it_is = block.retraction.manifold() == Manifold::kEuclidean &&
                                (all_free || block.NumFree() == size);
    if (moves_as_it_is) {
      problem_->AddParameterBlock(data, size);
    } else {
      manifolds_.push_back(std::make_unique<BlockManifold>(block, all_free));
      problem_->AddParameterBlock(data, size, manifolds_.back().get());
    }
    if (all_free) continue;
    if (block.NumFree() == 0) {
      problem_->SetParameterBlockConstant(data);
      continue;
    }
    active_bounds_.Add(problem_.get(), data, {block.lower, block.upper}, /*inexact=*/false);
  }
  for (const auto& factor : graph.factors) {
    losses_.push_back(MakeLoss(factor->loss(), factor->loss_scale()));
    std::vector<double*> parameters;
    for (const int b : factor->blocks()) parameters.push_back(values_[b].data());
    costs_.push_back(active_bounds_.Wrap(std::make_unique<Cost>(*factor, *this),
                                         losses_.back().get(), parameters));
    problem_->AddResidualBlock(costs_.back().get(), losses_.back().get(), parameters);
  }
}

CeresGraph::~CeresGraph() = default;

bool CeresGraph::Evaluate(const Factor& factor, double const* const* parameters, double* residuals,
                          double** jacobians) const {
  return abandonment_.Guard([&] { return factor.Evaluate(parameters, residuals, jacobians); });
}

bool CeresGraph::IsThreadSafe() const {
  return std::all_of(graph_.factors.begin(), graph_.factors.end(),
                     [](const auto& factor) { return factor->IsThreadSafe(); });
}

int64_t CeresGraph::CountInformationNonzeros() const {
  std::set<std::pair<int, int>> coupled;
  for (const auto& factor : graph_.factors) {
    for (const int a : factor->blocks()) {
      for (const int b : factor->blocks()) coupled.emplace(a, b);
    }
  }
  int64_t count = 0;
  for (const auto& [a, b] : coupled) {
    count += static_cast<int64_t>(graph_.blocks[a].NumFree()) * graph_.blocks[b].NumFree();
  }
  return count;
}

}  // namespace bundle
