#include "core/graph/factor_graph.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "core/error.h"
#include "core/factors/checked_value.h"
#include "core/factors/whitening.h"

namespace bundle {
namespace {

void CheckBounds(const Block& block) {
  if (block.lower.empty() && block.upper.empty()) return;
  if (block.retraction.manifold() != Manifold::kEuclidean) {
    throw InputError(block.name + ": bounds: expected on a euclidean variable, found " +
                     block.retraction.name());
  }
  const size_t n = block.value.size();
  if (block.lower.size() != n || block.upper.size() != n) {
    throw InputError(block.name + ": bounds: expected " + std::to_string(n) + " numbers, found " +
                     std::to_string(std::min(block.lower.size(), block.upper.size())));
  }
  for (size_t i = 0; i < n; ++i) {
    // A bound that is no number fails both comparisons.
    if (block.lower[i] <= block.value[i] && block.value[i] <= block.upper[i]) continue;
    throw InputError(block.name + ": expected a start within its bounds, found " +
                     ShortNumber(block.value[i]) + " at [" + std::to_string(i) + "], bounds " +
                     ShortNumber(block.lower[i]) + " to " + ShortNumber(block.upper[i]));
  }
}

}  // namespace

void CheckBlock(const Block& block) {
  CheckedValue(block.name, block.retraction, block.value);
  if (!block.held.empty() &&
      static_cast<int>(block.held.size()) != block.retraction.tangent_size()) {
    throw InputError(block.name + ": held: expected " +
                     std::to_string(block.retraction.tangent_size()) + " flags, found " +
                     std::to_string(block.held.size()));
  }
  CheckBounds(block);
}

void CheckVariables(const Factor& factor, const std::vector<Block>& blocks) {
  const auto& indices = factor.blocks();
  if (indices.size() != factor.retractions().size()) {
    throw InputError(factor.name() + ": expected " + std::to_string(factor.retractions().size()) +
                     " variables, found " + std::to_string(indices.size()));
  }
  for (size_t b = 0; b < indices.size(); ++b) {
    if (indices[b] < 0 || indices[b] >= static_cast<int>(blocks.size())) {
      throw InputError(factor.name() + ": there is no variable " + std::to_string(indices[b]));
    }
    const Block& block = blocks[indices[b]];
    if (std::find(indices.begin(), indices.begin() + b, indices[b]) != indices.begin() + b) {
      throw InputError(factor.name() + ": " + block.name + ": expected different variables, " +
                       "found it twice");
    }
    const Retraction& expected = factor.retractions()[b];
    if (block.retraction == expected) continue;
    throw InputError(factor.name() + ": " + block.name + ": expected " + expected.name() + " of " +
                     std::to_string(expected.ambient_size()) + " numbers, found " +
                     block.retraction.name() + " of " +
                     std::to_string(block.retraction.ambient_size()));
  }
}

namespace {

void CheckEvaluation(const Factor& factor, const std::vector<Block>& blocks) {
  const size_t num_blocks = factor.blocks().size();
  std::vector<double> residual(factor.num_residuals());
  std::vector<std::vector<double>> storage(num_blocks);
  std::vector<double*> jacobians(num_blocks);
  for (size_t b = 0; b < num_blocks; ++b) {
    storage[b].resize(residual.size() * factor.retractions()[b].tangent_size());
    jacobians[b] = storage[b].data();
  }
  const auto values = ValuesOf(factor, blocks);
  if (!factor.Evaluate(values.data(), residual.data(), jacobians.data())) {
    throw InputError(factor.name() + ": the residual has no value at the start");
  }
  for (size_t r = 0; r < residual.size(); ++r) {
    if (std::isfinite(residual[r])) continue;
    throw InputError(factor.name() + ": expected a finite residual at the start, found " +
                     std::to_string(residual[r]) + " in row " + std::to_string(r));
  }
  for (size_t b = 0; b < num_blocks; ++b) {
    const auto bad = std::find_if(storage[b].begin(), storage[b].end(),
                                  [](double value) { return !std::isfinite(value); });
    if (bad == storage[b].end()) continue;
    const int columns = factor.retractions()[b].tangent_size();
    const int place = static_cast<int>(bad - storage[b].begin());
    throw InputError(factor.name() + ": " + blocks[factor.blocks()[b]].name +
                     ": expected a finite Jacobian at the start, found " + std::to_string(*bad) +
                     " in row " + std::to_string(place / columns) + ", column " +
                     std::to_string(place % columns));
  }
}

}  // namespace

std::vector<const double*> ValuesOf(const Factor& factor, const std::vector<Block>& blocks) {
  std::vector<const double*> values;
  for (const int b : factor.blocks()) values.push_back(blocks[b].value.data());
  return values;
}

void ValidateGraph(const FactorGraph& graph) {
  if (graph.factors.empty()) throw InputError("factor graph: expected factors, found none");
  std::vector<bool> has_factor(graph.blocks.size(), false);
  for (const Block& block : graph.blocks) CheckBlock(block);
  for (const auto& factor : graph.factors) {
    CheckVariables(*factor, graph.blocks);
    for (const int b : factor->blocks()) has_factor[b] = true;
  }
  for (size_t b = 0; b < graph.blocks.size(); ++b) {
    if (has_factor[b] || graph.blocks[b].NumFree() == 0) continue;
    throw InputError(graph.blocks[b].name + ": expected a factor that touches it, found none");
  }
  for (const auto& factor : graph.factors) CheckEvaluation(*factor, graph.blocks);
}

}  // namespace bundle
