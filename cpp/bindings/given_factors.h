#pragma once

/// The factors of a Python problem, other than its observations.

#include <pybind11/pybind11.h>

#include <string>
#include <utility>
#include <vector>

#include "bindings/graph_from_python.h"
#include "core/graph/factor_graph.h"
#include "core/model/problem_factors.h"

/// Made from (variables, factors, the problem variable of each variable), the first two as in
/// bind_graph.
class GivenFactors {
 public:
  explicit GivenFactors(const pybind11::object& given) {
    if (given.is_none()) return;
    const auto parts = pybind11::cast<pybind11::tuple>(given);
    graph_ = GraphFromPython(pybind11::cast<pybind11::list>(parts[0]),
                             pybind11::cast<pybind11::list>(parts[1]));
    for (const pybind11::handle& place : pybind11::cast<pybind11::sequence>(parts[2])) {
      const auto [kind, index] = pybind11::cast<std::pair<std::string, int>>(place);
      using Kind = bundle::ProblemVariable::Kind;
      factors_.variables.push_back({kind == "image"     ? Kind::kImage
                                    : kind == "camera"  ? Kind::kCamera
                                    : kind == "frame"   ? Kind::kFrame
                                    : kind == "sensor"  ? Kind::kSensor
                                    : kind == "twist"   ? Kind::kTwist
                                    : kind == "readout" ? Kind::kReadout
                                                        : Kind::kPoint,
                                    index});
    }
  }

  /// Call once; returns nullptr without factors.
  const bundle::ProblemFactors* Check() {
    if (graph_.factors.empty()) return nullptr;
    bundle::ValidateGraph(graph_);
    factors_.factors = std::move(graph_.factors);
    return &factors_;
  }

  bool empty() const { return factors_.factors.empty(); }

  /// Checks the factors at other values of the problem, too.
  void CheckAt(const bundle::AdjustmentProblem& problem) const {
    std::vector<bundle::Block> blocks = graph_.blocks;
    for (size_t v = 0; v < blocks.size(); ++v) {
      bundle::Block& block = blocks[v];
      const double* const value = bundle::ValueOf(factors_.variables[v], problem);
      block.value = bundle::CheckedValue(block.name, block.retraction,
                                         std::vector<double>(value, value + block.value.size()));
    }
    for (const auto& factor : factors_.factors) bundle::CheckEvaluation(*factor, blocks);
  }

 private:
  bundle::FactorGraph graph_;  ///< loses its factors once they are checked
  bundle::ProblemFactors factors_;
};
