#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <functional>
#include <string>
#include <utility>

#include "bindings/immutable_array.h"
#include "bindings/pose_graph_from_python.h"
#include "bindings/python_progress.h"
#include "core/error.h"
#include "core/pose_graph/certificate.h"

namespace py = pybind11;

namespace bundle {
namespace {

void PutBound(const DualBound& bound, const std::string& prefix, py::dict* result) {
  const auto put = [&](const char* name, auto value) { (*result)[py::str(prefix + name)] = value; };
  put("trace", bound.trace);
  put("shift", bound.shift);
  put("bound", bound.bound);
  put("holds", bound.holds);
}

py::dict CertificateToPython(PosesCertificate found, const GraphArrays& arrays) {
  py::dict result;
  result["initial_cost"] = found.newton.initial_cost;
  result["cost"] = found.newton.cost;
  result["num_steps"] = found.newton.num_steps;
  result["converged"] = found.newton.converged;
  result["is_minimum"] = found.newton.is_minimum;
  PutBound(found.bound, "", &result);
  result["eigenvalues"] = found.eigenvalues;
  result["eigenvalue_of_rows"] = found.eigenvalue_of_rows;
  result["poses"] =
      ToImmutableNumpy(std::move(found.poses), {arrays.poses.shape(0), arrays.poses.shape(1)});
  return result;
}

py::dict CertifyGraphFromPython(const py::object& graph, const Array<double>& kappa,
                                const Array<double>& tau, int max_rank, int max_steps,
                                int num_eigenvalues, bool explicit_form, int num_threads,
                                const py::object& progress) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewGraph(arrays, arrays.fixed);
  if (kappa.size() != view.num_edges() || tau.size() != view.num_edges()) {
    throw InputError("kappa, tau: expected a weight for each edge");
  }
  CertifyOptions options;
  options.max_rank = max_rank;
  options.max_steps = max_steps;
  options.num_eigenvalues = num_eigenvalues;
  options.explicit_form = explicit_form;
  options.num_threads = num_threads;
  PythonProgress report(progress);
  options.progress = std::ref(report);
  GraphCertificate found =
      RunWatched(&report, [&] { return CertifyGraph(view, kappa.data(), tau.data(), options); });
  report.Rethrow();
  py::dict result = CertificateToPython(std::move(found.of_poses), arrays);
  result["rank"] = found.rank;
  if (found.rank > 0) {
    py::dict after = CertificateToPython(std::move(found.after_staircase), arrays);
    after["relaxed_cost"] = found.relaxed_cost;
    PutBound(found.relaxed_bound, "relaxed_", &after);
    result["staircase"] = after;
  }
  return result;
}

}  // namespace
}  // namespace bundle

void BindCertificate(py::module_& m) {
  m.def("certify_graph", &bundle::CertifyGraphFromPython, py::arg("graph"), py::arg("kappa"),
        py::arg("tau"), py::kw_only(), py::arg("max_rank"), py::arg("max_steps"),
        py::arg("num_eigenvalues"), py::arg("explicit_form"), py::arg("num_threads"),
        py::arg("progress") = py::none());
}
