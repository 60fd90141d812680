#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/graph_from_python.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/python_progress.h"
#include "bindings/summary_to_python.h"
#include "bindings/to_numpy.h"
#include "core/ceres/solve_graph.h"
#include "core/error.h"
#include "core/factors/factor.h"
#include "core/graph/factor_graph.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/memory.h"
#include "core/solver/jacobian_conditioning.h"
#include "core/solver/linear_finish.h"
#include "core/solver/marginal_by_root.h"
#include "core/solver/square_root_solver.h"

namespace py = pybind11;

namespace {

py::dict SolveGraph(const py::list& variables, const py::list& factors, const py::dict& options,
                    const py::object& progress, bool square_root) {
  const bundle::FactorGraph graph = GraphFromPython(variables, factors);
  const bundle::SolveOptions solve_options = GraphOptionsFromPython(options);
  PythonProgress report(progress);
  bundle::GraphOutput output = RunWatched(&report, [&] {
    bundle::GraphOutput solved =
        square_root ? bundle::SolveGraphBySquareRoot(graph, solve_options, std::ref(report))
                    : bundle::SolveGraph(graph, solve_options, std::ref(report));
    bundle::FinishLinearGraph(graph, &solved);
    return solved;
  });
  report.Rethrow();
  py::list values;
  for (std::vector<double>& value : output.values) {
    const auto size = static_cast<py::ssize_t>(value.size());
    values.append(ToImmutableNumpy(std::move(value), {size}));
  }
  py::dict result;
  result["values"] = values;
  PutRecord(output, &result);
  return result;
}

/// (largest, smallest singular value, columns, variables of dependent columns)
py::tuple GraphConditioning(const py::list& variables, const py::list& factors) {
  const bundle::FactorGraph graph = GraphFromPython(variables, factors);
  PythonProgress report(py::none{});
  const bundle::JacobianConditioning found =
      RunWatched(&report, [&] { return bundle::EstimateConditioning(graph); });
  return py::make_tuple(found.max_singular_value, found.min_singular_value, found.num_columns,
                        found.dependent);
}

bundle::LinearizedGraph Linearize(const bundle::FactorGraph& graph, int num_threads) {
  PythonProgress report(py::none{});
  return RunWatched(&report, [&] {
    bundle::ValidateGraph(graph);
    return bundle::LinearizeGraph(graph, num_threads);
  });
}

double GraphCost(const py::list& variables, const py::list& factors) {
  return Linearize(GraphFromPython(variables, factors), 1).cost;
}

/// Residual and dense Jacobian over all tangent coordinates, losses applied.
py::tuple GraphJacobian(const py::list& variables, const py::list& factors) {
  const bundle::FactorGraph graph = GraphFromPython(variables, factors);
  bundle::LinearizedGraph linear = Linearize(graph, 1);
  const auto rows = static_cast<py::ssize_t>(linear.residual.size());
  const auto columns = static_cast<py::ssize_t>(linear.block_begin.back());
  // J, its columns split and scaled, and the workspace of the factorisation.
  const double bytes = 8.0 * 4 * static_cast<double>(rows) * static_cast<double>(columns);
  const double available = bundle::AvailableMemoryFor(bytes);
  if (!bundle::FitsIntoMemory(bytes, available)) {
    throw bundle::InputError("keys: a dense Jacobian of " + std::to_string(rows) + " rows and " +
                             std::to_string(columns) + " columns needs " +
                             bundle::ShortNumber(bytes / 1e9) + " GB; this machine has " +
                             bundle::ShortNumber(available / 1e9) +
                             " free; eliminate fewer variables at a time");
  }
  std::vector<double> dense(static_cast<size_t>(rows * columns));
  for (py::ssize_t r = 0; r < rows; ++r) {
    for (int64_t k = linear.row_begin[r]; k < linear.row_begin[r + 1]; ++k) {
      dense[r * columns + linear.columns[k]] = linear.values[k];
    }
  }
  return py::make_tuple(ToImmutableNumpy(std::move(linear.residual), {rows}),
                        ToImmutableNumpy(std::move(dense), {rows, columns}));
}

/// Throws InputError if the dense matrices of a marginal information do not fit into the free
/// memory: Lambda and its products, and the kept columns in addition to the factor of the
/// eliminated ones.
void RefuseTooManyColumns(const std::vector<int>& kept, const std::vector<bundle::Block>& blocks) {
  double num_kept = 0, num_others = 0;
  for (const bundle::Block& block : blocks) num_others += block.NumFree();
  for (const int b : kept) {
    num_kept += blocks[b].retraction.tangent_size();
    num_others -= blocks[b].NumFree();
  }
  const double bytes = 8 * (3 * num_kept * num_kept + 2 * num_others * (num_kept + 1));
  const double available = bundle::AvailableMemoryFor(bytes);
  if (bundle::FitsIntoMemory(bytes, available)) return;
  throw bundle::InputError("keys: the information of " + bundle::ShortNumber(num_kept) +
                           " coordinates needs " + bundle::ShortNumber(bytes / 1e9) +
                           " GB; this machine has " + bundle::ShortNumber(available / 1e9) +
                           " free; ask for fewer variables");
}

py::tuple MarginalInformation(const py::list& variables, const py::list& factors,
                              const std::vector<int>& kept) {
  const bundle::FactorGraph graph = GraphFromPython(variables, factors);
  RefuseTooManyColumns(kept, graph.blocks);
  const bundle::LinearizedGraph linear = Linearize(graph, 1);
  bundle::MarginalInformation found = [&] {
    const ReleaseGil release;
    return bundle::FindMarginalInformation(kept, graph.blocks, linear);
  }();
  const auto n = static_cast<py::ssize_t>(found.eta.size());
  return py::make_tuple(ToImmutableNumpy(std::move(found.lambda), {n, n}),
                        ToImmutableNumpy(std::move(found.eta), {n}));
}

/// A function of the values of a factor's variables: (residual, Jacobians), or None if it has no
/// value. Throws InputError if the variables do not fit the factor.
py::cpp_function FactorFunction(const py::list& variables, const py::tuple& factor) {
  auto graph = std::make_shared<bundle::FactorGraph>(
      GraphFromPython(variables, py::list(py::make_tuple(factor))));
  bundle::CheckVariables(*graph->factors[0], graph->blocks);
  return py::cpp_function([graph](const std::vector<CastArray<double>>& values) -> py::object {
    const bundle::Factor& made = *graph->factors[0];
    const py::ssize_t rows = made.num_residuals();
    CastArray<double> residual(rows);
    py::list matrices;
    std::vector<const double*> pointers;
    std::vector<double*> jacobians;
    for (size_t b = 0; b < made.retractions().size(); ++b) {
      if (values.size() != made.retractions().size() ||
          values[b].size() != made.retractions()[b].ambient_size()) {
        throw bundle::InputError(made.name() + ": expected the values of its variables");
      }
      CastArray<double> jacobian(
          {rows, static_cast<py::ssize_t>(made.retractions()[b].tangent_size())});
      pointers.push_back(values[b].data());
      jacobians.push_back(jacobian.mutable_data());
      matrices.append(jacobian);
    }
    try {
      if (!made.Evaluate(pointers.data(), residual.mutable_data(), jacobians.data())) {
        return py::none();
      }
    } catch (const bundle::Interrupted&) {
      PyErr_SetNone(PyExc_KeyboardInterrupt);
      throw py::error_already_set();
    }
    return py::make_tuple(residual, matrices);
  });
}

bundle::Retraction RetractionOf(const std::string& manifold, const CastArray<double>& x) {
  return bundle::RetractionFromName(manifold, static_cast<int>(x.size()));
}

void CheckTangent(const bundle::Retraction& retraction, const CastArray<double>& delta) {
  if (delta.size() == retraction.tangent_size()) return;
  throw bundle::InputError("expected " + std::to_string(retraction.tangent_size()) +
                           " tangent coordinates, found " + std::to_string(delta.size()));
}

CastArray<double> Retract(const std::string& manifold, const CastArray<double>& x,
                          const CastArray<double>& delta) {
  const bundle::Retraction retraction = RetractionOf(manifold, x);
  CheckTangent(retraction, delta);
  CastArray<double> moved(x.size());
  retraction.Plus(x.data(), delta.data(), moved.mutable_data());
  return moved;
}

CastArray<double> Local(const std::string& manifold, const CastArray<double>& x,
                        const CastArray<double>& y) {
  const bundle::Retraction retraction = RetractionOf(manifold, x);
  if (retraction != RetractionOf(manifold, y)) {
    throw bundle::InputError("expected two values of one manifold");
  }
  CastArray<double> delta(static_cast<py::ssize_t>(retraction.tangent_size()));
  retraction.Local(x.data(), y.data(), delta.mutable_data());
  return delta;
}

CastArray<double> RightJacobian(const std::string& manifold, const CastArray<double>& x,
                                const CastArray<double>& delta) {
  const bundle::Retraction retraction = RetractionOf(manifold, x);
  CheckTangent(retraction, delta);
  const py::ssize_t n = retraction.tangent_size();
  CastArray<double> jacobian({n, n});
  retraction.RightJacobian(delta.data(), jacobian.mutable_data());
  return jacobian;
}

/// The value in its stored form, and the names of the tangent coordinates.
py::tuple CheckValue(const std::string& name, const std::string& manifold,
                     const CastArray<double>& value) {
  const bundle::Retraction retraction = [&] {
    try {
      return RetractionOf(manifold, value);
    } catch (const bundle::InputError& error) {
      throw bundle::InputError(name + ": " + error.what());
    }
  }();
  std::vector<double> checked = bundle::CheckedValue(
      name, retraction, std::vector<double>(value.data(), value.data() + value.size()));
  py::list names;
  for (int i = 0; i < retraction.tangent_size(); ++i) names.append(retraction.CoordinateName(i));
  const auto size = static_cast<py::ssize_t>(checked.size());
  return py::make_tuple(ToImmutableNumpy(std::move(checked), {size}), names);
}

void CheckVariable(const py::tuple& variable) { bundle::CheckBlock(VariableFromPython(variable)); }

}  // namespace

void BindGraph(py::module_& m) {
  m.def("solve_graph", &SolveGraph, py::arg("variables"), py::arg("factors"), py::arg("options"),
        py::arg("progress"), py::arg("square_root"));
  m.def("graph_conditioning", &GraphConditioning, py::arg("variables"), py::arg("factors"));
  m.def("graph_jacobian", &GraphJacobian, py::arg("variables"), py::arg("factors"));
  m.def("graph_cost", &GraphCost, py::arg("variables"), py::arg("factors"));
  m.def("marginal_information", &MarginalInformation, py::arg("variables"), py::arg("factors"),
        py::arg("kept"));
  m.def("factor_function", &FactorFunction, py::arg("variables"), py::arg("factor"));
  m.def("retract", &Retract, py::arg("manifold"), py::arg("x"), py::arg("delta"));
  m.def("local_coordinates", &Local, py::arg("manifold"), py::arg("x"), py::arg("y"));
  m.def("right_jacobian", &RightJacobian, py::arg("manifold"), py::arg("x"), py::arg("delta"));
  m.def("check_value", &CheckValue, py::arg("name"), py::arg("manifold"), py::arg("value"));
  m.def("check_variable", &CheckVariable, py::arg("variable"));
}
