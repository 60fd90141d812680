#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "bindings/gil.h"
#include "bindings/graph_from_python.h"
#include "bindings/immutable_array.h"
#include "bindings/pose_graph_from_python.h"
#include "bindings/python_progress.h"
#include "core/ceres/solve_graph.h"
#include "core/diagnosis/factor_graph_certainty.h"
#include "core/diagnosis/graph_spectrum.h"
#include "core/error.h"
#include "core/model/factor_costs.h"
#include "core/pose_graph/block_pattern_of_edges.h"
#include "core/pose_graph/graph_covariance.h"

namespace py = pybind11;

namespace bundle {
namespace {

PoseErrorOptions ErrorOfName(const std::string& name) {
  PoseErrorOptions errors;
  errors.error = PoseErrorFromName(name);
  return errors;
}

py::dict GraphCovarianceFromPython(const py::object& graph, const std::string& error, bool inner,
                                   bool of_edges,
                                   const std::vector<std::pair<int32_t, int32_t>>& relative,
                                   int num_threads) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewWithErrors(arrays, arrays.fixed);
  for (const auto& [a, b] : relative) {
    if (a < 0 || b < 0 || a >= view.num_poses || b >= view.num_poses) {
      throw InputError("relative: expected positions of poses");
    }
  }
  PythonProgress watch{py::none()};
  GraphCovarianceOutput found = RunWatched(&watch, [&] {
    return ComputeGraphCovariance(MakePoseGraph(view, ErrorOfName(error)), view.held,
                                  {inner, of_edges, relative, num_threads});
  });
  watch.Rethrow();
  const py::ssize_t d = view.tangent();
  const auto blocks = [d](std::vector<double> values) {
    const auto count = static_cast<py::ssize_t>(values.size()) / (d * d);
    return ToImmutableNumpy(std::move(values), {count, d, d});
  };
  const auto count = static_cast<py::ssize_t>(found.edge_test.size());
  py::dict result;
  result["poses"] = blocks(std::move(found.poses));
  result["relative"] = blocks(std::move(found.relative));
  result["across"] = blocks(std::move(found.across));
  result["edge_redundancy"] = ToImmutableNumpy(std::move(found.edge_redundancy), {count});
  result["edge_test"] = ToImmutableNumpy(std::move(found.edge_test), {count});
  result["edge_rank"] = ToImmutableNumpy(std::move(found.edge_rank), {count});
  result["predicted_decrease"] = found.predicted_decrease;
  result["inflation"] = found.inflation;
  result["undetermined_pose"] = found.undetermined_pose;
  return result;
}

py::dict GraphSpectrumFromPython(const py::object& graph, const Array<bool>& held,
                                 const std::string& error, const Array<double>& null_directions,
                                 int num_threads) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewWithErrors(arrays, held);
  if (null_directions.ndim() != 2 || null_directions.shape(0) != view.num_poses * view.tangent()) {
    throw InputError("null_directions: expected a row for each tangent coordinate");
  }
  PythonProgress watch{py::none()};
  GraphSpectrum found = RunWatched(&watch, [&] {
    return FindGraphSpectrum(MakePoseGraph(view, ErrorOfName(error)), null_directions.data(),
                             static_cast<int>(null_directions.shape(1)), num_threads);
  });
  watch.Rethrow();
  py::dict result;
  const auto count = static_cast<py::ssize_t>(found.eigenvalues.size());
  result["eigenvalues"] = ToImmutableNumpy(std::move(found.eigenvalues), {count});
  result["max_eigenvalue"] = found.max_eigenvalue;
  result["condition_number"] = found.condition_number;
  result["condition_number_unscaled"] = found.condition_number_unscaled;
  return result;
}

/// Ordering that a solve chooses: "natural", "amd" or "metis"; "" without free poses.
std::string AutoOrdering(const py::object& graph, const Array<bool>& held) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewGraph(arrays, held);
  const PoseGraph made = MakePoseGraph(view, {});
  if (std::all_of(made.held.begin(), made.held.end(), [](uint8_t h) { return h != 0; })) return "";
  const ReleaseGil release;
  return OrderEdges(made, view.tangent(), "auto").name;
}

std::vector<uint8_t> HeldOf(const Array<bool>& held, const FactorGraph& graph) {
  py::ssize_t size = 0;
  for (const Block& block : graph.blocks) size += block.retraction.tangent_size();
  if (held.size() != size) throw InputError("held: expected a flag for each tangent coordinate");
  return {held.data(), held.data() + held.size()};
}

py::array ToArray(PlainMatrix matrix) {
  return ToImmutableNumpy(std::move(matrix.values), {matrix.rows, matrix.columns});
}

template <typename T>
py::array ToArray(std::vector<T> values) {
  const auto count = static_cast<py::ssize_t>(values.size());
  return ToImmutableNumpy(std::move(values), {count});
}

py::dict FactorGraphCertaintyFromPython(const py::list& variables, const py::list& factors,
                                        const Array<bool>& held,
                                        const std::vector<std::pair<int, int>>& pairs,
                                        const Array<double>& null_seed, bool of_factors,
                                        int num_threads) {
  const FactorGraph graph = GraphFromPython(variables, factors);
  FactorGraphRequest request;
  request.held = HeldOf(held, graph);
  request.pairs = pairs;
  request.of_factors = of_factors;
  request.num_threads = num_threads;
  request.null_seed = {null_seed.shape(0),
                       null_seed.shape(1),
                       {null_seed.data(), null_seed.data() + null_seed.size()}};
  PythonProgress watch{py::none()};
  FactorGraphCertainty found = RunWatched(&watch, [&] {
    ValidateGraph(graph);
    return ComputeFactorGraphCertainty(graph, LinearizeGraph(graph, num_threads), request);
  });
  watch.Rethrow();
  py::list blocks, across;
  for (PlainMatrix& block : found.variables) blocks.append(ToArray(std::move(block)));
  for (PlainMatrix& block : found.across) across.append(ToArray(std::move(block)));
  py::dict result;
  result["variables"] = blocks;
  result["across"] = across;
  result["redundancy"] = ToArray(std::move(found.redundancy));
  result["test"] = ToArray(std::move(found.test));
  result["rank"] = ToArray(std::move(found.rank));
  result["predicted_decrease"] = found.predicted_decrease;
  result["inflation"] = found.inflation;
  result["undetermined"] = found.undetermined;
  return result;
}

py::dict FactorGraphSpectrumFromPython(const py::list& variables, const py::list& factors,
                                       const Array<bool>& held, int num_null, int num_threads) {
  const FactorGraph graph = GraphFromPython(variables, factors);
  const std::vector<uint8_t> flags = HeldOf(held, graph);
  PythonProgress watch{py::none()};
  FactorGraphSpectrum found = RunWatched(&watch, [&] {
    ValidateGraph(graph);
    return FindFactorGraphSpectrum(graph, LinearizeGraph(graph, num_threads), flags, num_null,
                                   num_threads);
  });
  watch.Rethrow();
  py::dict result;
  result["eigenvalues"] = ToArray(std::move(found.eigenvalues));
  result["null_directions"] = ToArray(std::move(found.null_directions));
  result["directions"] = ToArray(std::move(found.directions));
  result["condition_number"] = found.condition_number;
  result["condition_number_unscaled"] = found.condition_number_unscaled;
  return result;
}

/// Cost 1/2 rho, squared norm r^T r without loss, and number of independent residuals of each
/// factor.
py::tuple FactorCostsFromPython(const py::list& variables, const py::list& factors) {
  const FactorGraph graph = GraphFromPython(variables, factors);
  PythonProgress watch{py::none()};
  std::vector<double> costs, squares;
  std::vector<int64_t> sizes;
  RunWatched(&watch, [&] {
    ValidateGraph(graph);
    for (const auto& factor : graph.factors) {
      std::vector<double> residual(factor->num_residuals());
      factor->Evaluate(ValuesOf(*factor, graph.blocks).data(), residual.data(), nullptr);
      double sum = 0;
      for (const double value : residual) sum += value * value;
      squares.push_back(sum);
      sizes.push_back(factor->num_measurements());
      costs.push_back(ApplyLoss(*factor, 0, residual.data(), nullptr));
    }
    return 0;
  });
  watch.Rethrow();
  return py::make_tuple(ToArray(std::move(costs)), ToArray(std::move(squares)),
                        ToArray(std::move(sizes)));
}

}  // namespace
}  // namespace bundle

void BindGraphCertainty(py::module_& m) {
  m.def("graph_covariance", &bundle::GraphCovarianceFromPython, py::arg("graph"), py::arg("error"),
        py::arg("inner"), py::arg("of_edges"), py::arg("relative"), py::arg("num_threads"));
  m.def("factor_graph_certainty", &bundle::FactorGraphCertaintyFromPython, py::arg("variables"),
        py::arg("factors"), py::arg("held"), py::arg("pairs"), py::arg("null_seed"),
        py::arg("of_factors"), py::arg("num_threads"));
  m.def("factor_graph_spectrum", &bundle::FactorGraphSpectrumFromPython, py::arg("variables"),
        py::arg("factors"), py::arg("held"), py::arg("num_null"), py::arg("num_threads"));
  m.def("factor_costs", &bundle::FactorCostsFromPython, py::arg("variables"), py::arg("factors"));
  m.def("auto_ordering", &bundle::AutoOrdering, py::arg("graph"), py::arg("held"));
  m.def("graph_spectrum", &bundle::GraphSpectrumFromPython, py::arg("graph"), py::arg("held"),
        py::arg("error"), py::arg("null_directions"), py::arg("num_threads"));
}
