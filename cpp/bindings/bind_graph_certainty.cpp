#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "bindings/immutable_array.h"
#include "bindings/pose_graph_from_python.h"
#include "bindings/python_progress.h"
#include "core/diagnosis/graph_spectrum.h"
#include "core/error.h"
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
  const PoseGraphView view = ViewGraph(arrays, arrays.fixed);
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
  const PoseGraphView view = ViewGraph(arrays, held);
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
  PoseGraphView view = ViewGraph(arrays, held);
  view.information = nullptr;
  const PoseGraph made = MakePoseGraph(view, {});
  if (std::all_of(made.held.begin(), made.held.end(), [](uint8_t h) { return h != 0; })) return "";
  const py::gil_scoped_release release;
  return PatternOfEdges(made, view.tangent(), "auto").ordering.name;
}

}  // namespace
}  // namespace bundle

void BindGraphCertainty(py::module_& m) {
  m.def("graph_covariance", &bundle::GraphCovarianceFromPython, py::arg("graph"), py::arg("error"),
        py::arg("inner"), py::arg("of_edges"), py::arg("relative"), py::arg("num_threads"));
  m.def("auto_ordering", &bundle::AutoOrdering, py::arg("graph"), py::arg("held"));
  m.def("graph_spectrum", &bundle::GraphSpectrumFromPython, py::arg("graph"), py::arg("held"),
        py::arg("error"), py::arg("null_directions"), py::arg("num_threads"));
}
