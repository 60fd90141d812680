#include "core/ceres/factor_adapter.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "core/ceres/translate_options.h"
#include "core/error.h"
#include "core/factors/factor.h"
#include "core/parallel/interruption.h"

namespace bundle {

namespace {

void ExpectSize(const std::string& name, int found, int expected) {
  if (found == expected) return;
  throw InputError("manifolds: " + name + " expects a block of " + std::to_string(expected) +
                   " numbers, found " + std::to_string(found));
}

void CheckSubset(int size, const std::vector<int>& constant) {
  const std::set<int> distinct(constant.begin(), constant.end());
  if (distinct.size() != constant.size()) {
    throw InputError("manifolds: subset names an entry twice");
  }
  if (static_cast<int>(distinct.size()) >= size) {
    throw InputError("manifolds: subset leaves nothing of " + std::to_string(size) + " numbers");
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
      if (jacobians[b] == nullptr) continue;
      Widen(rows, factor_.retractions()[b], jacobians[b]);
      const int bounded = graph_.bounded_of_block_[factor_.blocks()[b]];
      if (bounded >= 0) ClearColumns(rows, graph_.bounded_[bounded].is_active, jacobians[b]);
    }
    return true;
  }

 private:
  /// J to [J 0] in place, from the last row on: no row has moved when it is read.
  static void Widen(int rows, const Retraction& retraction, double* jacobian) {
    const int narrow = retraction.tangent_size(), wide = retraction.ambient_size();
    if (narrow == wide) return;
    for (int r = rows - 1; r >= 0; --r) {
      std::copy_backward(jacobian + r * narrow, jacobian + (r + 1) * narrow,
                         jacobian + r * wide + narrow);
      std::fill(jacobian + r * wide + narrow, jacobian + (r + 1) * wide, 0.0);
    }
  }

  static void ClearColumns(int rows, const std::vector<bool>& which, double* jacobian) {
    const size_t size = which.size();
    for (size_t i = 0; i < size; ++i) {
      for (int r = 0; which[i] && r < rows; ++r) jacobian[r * size + i] = 0;
    }
  }

  const Factor& factor_;
  const CeresGraph& graph_;
};

class CeresGraph::Watch final : public ceres::EvaluationCallback {
 public:
  explicit Watch(CeresGraph* graph) : graph_(graph) {}

  void PrepareForEvaluation(bool evaluate_jacobians, bool /*new_evaluation_point*/) override {
    if (evaluate_jacobians) {
      graph_->FindActiveCoordinates();
    } else if (InterruptionRequested()) {
      graph_->abandoned_.store(true);
    }
  }

 private:
  CeresGraph* graph_;
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
    : graph_(graph),
      bounded_of_block_(graph.blocks.size(), -1),
      watch_(std::make_unique<Watch>(this)) {
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
    if (!block.lower.empty()) {
      const int index = static_cast<int>(values_.size()) - 1;
      bounded_of_block_[index] = static_cast<int>(bounded_.size());
      bounded_.push_back({index, {}, std::vector<bool>(size)});
    }
    for (size_t i = 0; i < block.lower.size(); ++i) {
      if (std::isfinite(block.lower[i]))
        problem_->SetParameterLowerBound(data, static_cast<int>(i), block.lower[i]);
      if (std::isfinite(block.upper[i]))
        problem_->SetParameterUpperBound(data, static_cast<int>(i), block.upper[i]);
    }
  }
  for (const auto& factor : graph.factors) {
    costs_.push_back(std::make_unique<Cost>(*factor, *this));
    losses_.push_back(MakeLoss(factor->loss(), factor->loss_scale()));
    std::vector<double*> parameters;
    for (const int b : factor->blocks()) {
      parameters.push_back(values_[b].data());
      const int bounded = bounded_of_block_[b];
      const int index = static_cast<int>(costs_.size()) - 1;
      if (bounded >= 0) bounded_[bounded].factors.push_back(index);
    }
    problem_->AddResidualBlock(costs_.back().get(), losses_.back().get(), parameters);
  }
}

CeresGraph::~CeresGraph() = default;

bool CeresGraph::Evaluate(const Factor& factor, double const* const* parameters, double* residuals,
                          double** jacobians) const {
  if (abandoned_.load(std::memory_order_relaxed)) return false;
  try {
    return factor.Evaluate(parameters, residuals, jacobians);
  } catch (const Interrupted&) {
    abandoned_.store(true);
  } catch (...) {
    exception_.Keep();
    abandoned_.store(true);
  }
  return false;
}

void CeresGraph::FindActiveCoordinates() {
  for (Bounded& bounded : bounded_) {
    const Block& block = graph_.blocks[bounded.block];
    const std::vector<double>& x = values_[bounded.block];
    const size_t size = x.size();
    bounded.is_active.assign(size, false);
    bool at_bound = false;
    for (size_t i = 0; i < size; ++i) {
      at_bound = at_bound || x[i] <= block.lower[i] || x[i] >= block.upper[i];
    }
    if (!at_bound) continue;
    const std::vector<double> gradient = GradientOf(bounded);
    for (size_t i = 0; i < size; ++i) {
      bounded.is_active[i] = (x[i] <= block.lower[i] && gradient[i] > 0) ||
                             (x[i] >= block.upper[i] && gradient[i] < 0);
    }
  }
}

/// Of the cost by the block at the values; zeros where a factor has no value.
std::vector<double> CeresGraph::GradientOf(const Bounded& bounded) const {
  const size_t size = values_[bounded.block].size();
  std::vector<double> gradient(size), residual, jacobian;
  for (const int f : bounded.factors) {
    const Factor& factor = *graph_.factors[f];
    const int rows = factor.num_residuals();
    residual.resize(rows);
    jacobian.resize(rows * size);
    std::vector<const double*> parameters;
    std::vector<double*> jacobians;
    for (const int b : factor.blocks()) {
      parameters.push_back(values_[b].data());
      jacobians.push_back(b == bounded.block ? jacobian.data() : nullptr);
    }
    if (!Evaluate(factor, parameters.data(), residual.data(), jacobians.data())) {
      return std::vector<double>(size);
    }
    double rho[3] = {0, 1, 0}, squared = 0;
    for (const double r : residual) squared += r * r;
    if (losses_[f] != nullptr) losses_[f]->Evaluate(squared, rho);
    for (int r = 0; r < rows; ++r) {
      for (size_t i = 0; i < size; ++i)
        gradient[i] += rho[1] * residual[r] * jacobian[r * size + i];
    }
  }
  return gradient;
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
