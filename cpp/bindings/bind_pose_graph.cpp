#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bindings/file_access.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/pose_graph_from_python.h"
#include "bindings/python_progress.h"
#include "bindings/summary_to_python.h"
#include "core/error.h"
#include "core/io/g2o.h"
#include "core/linear/edge_system.h"
#include "core/linear/fill_ordering.h"
#include "core/pose_graph/block_pattern_of_edges.h"
#include "core/pose_graph/chordal.h"
#include "core/pose_graph/closures.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/initialise.h"
#include "core/pose_graph/pose_graph.h"
#include "core/solver/pose_graph_solver.h"

namespace py = pybind11;

namespace bundle {
namespace {

py::dict ReadG2oFile(const py::object& given_path) {
  const std::filesystem::path path = PathFromPython(given_path);
  G2oGraph graph;
  try {
    const ReleaseGil release;
    graph = ReadG2o(path, CheckSignals);
  } catch (const std::system_error& error) {
    ThrowOsError(error, path);
  }
  const auto n = static_cast<py::ssize_t>(graph.ids.size());
  const auto m = static_cast<py::ssize_t>(graph.edge_lines.size());
  const py::ssize_t ambient = graph.dimension == 2 ? 3 : 7, tangent = graph.dimension == 2 ? 3 : 6;
  std::vector<uint8_t> fixed = std::move(graph.fixed);
  py::dict result;
  result["has_vertices"] = graph.has_vertices;
  result["is_toro"] = graph.is_toro;
  result["num_plain_edges"] = graph.num_plain_edges;
  result["num_equivalences"] = graph.num_equivalences;
  result["num_sensor_packets"] = graph.num_sensor_packets;
  result["ids"] = ToImmutableNumpy(std::move(graph.ids), {n});
  result["poses"] = ToImmutableNumpy(std::move(graph.poses), {n, ambient});
  result["fixed"] = ToImmutableNumpy(std::move(fixed), {n});
  result["edges"] = ToImmutableNumpy(std::move(graph.edges), {m, 2});
  result["measurements"] = ToImmutableNumpy(std::move(graph.measurements), {m, ambient});
  result["information"] = ToImmutableNumpy(std::move(graph.information), {m, tangent, tangent});
  result["edge_lines"] = ToImmutableNumpy(std::move(graph.edge_lines), {m});
  return result;
}

void WriteG2oFile(const py::object& given_path, const py::object& graph,
                  const std::string& compression) {
  const std::filesystem::path path = PathFromPython(given_path);
  const GraphArrays arrays(graph);
  G2oView view;
  view.dimension = arrays.dimension();
  view.num_poses = arrays.poses.shape(0);
  view.num_edges = arrays.edges.shape(0);
  view.ids = arrays.ids.data();
  view.poses = arrays.poses.data();
  view.fixed = arrays.fixed_data();
  view.edges = arrays.edges.data();
  view.measurements = arrays.measurements.data();
  view.information = arrays.information.data();
  try {
    const ReleaseGil release;
    WriteG2o(view, path, CompressionFromName(compression), CheckSignals);
  } catch (const std::system_error& error) {
    ThrowOsError(error, path);
  }
}

EdgeLoss EdgeLossFromName(const std::string& name) {
  // Switchable constraints give the Geman-McClure loss once their switches are eliminated.
  if (name == "geman_mcclure" || name == "switchable") {
    return {EdgeLoss::Kind::kGemanMcClure, LossType::kTrivial};
  }
  if (name == "dcs") return {EdgeLoss::Kind::kDcs, LossType::kTrivial};
  return {EdgeLoss::Kind::kOfFactors, LossFromName(name)};
}

PoseErrorOptions ErrorsFromPython(const py::dict& options) {
  PoseErrorOptions errors;
  errors.error = PoseErrorFromName(py::cast<std::string>(options["error"]));
  errors.loss = EdgeLossFromName(py::cast<std::string>(options["loss"]));
  errors.loss_scale = py::cast<double>(options["loss_scale"]);
  return errors;
}

py::dict SolvePoseGraphFromPython(const py::object& graph, const Array<bool>& held,
                                  const Array<bool>& robust, const py::dict& options,
                                  const py::object& progress, const FillOrdering* order,
                                  bool with_trials, const std::optional<Array<double>>& chi2,
                                  const GraphArrays::Poses& poses) {
  const GraphArrays arrays(graph, poses);
  PoseGraphView view = ViewWithErrors(arrays, held);
  if (robust.size() != view.num_edges()) throw InputError("robust: expected a flag for each edge");
  view.robust = reinterpret_cast<const uint8_t*>(robust.data());
  if (chi2 && chi2->size() != view.num_edges()) {
    throw InputError("chi2: expected a number for each edge");
  }
  const PoseErrorOptions errors = ErrorsFromPython(options);
  SolveOptions solve_options;
  ReadPoseGraphOptions(options, &solve_options);
  const auto ordering = py::cast<std::string>(options["ordering"]);
  PythonProgress report(progress);
  PoseGraphOutput output = RunWatched(&report, [&] {
    return SolvePoseGraph(view, errors, solve_options, ordering, std::ref(report), order,
                          with_trials, chi2 ? chi2->data() : nullptr);
  });
  report.Rethrow();
  const py::ssize_t n = arrays.poses.shape(0), m = arrays.edges.shape(0);
  py::dict result;
  result["poses"] = ToImmutableNumpy(std::move(output.poses), {n, arrays.poses.shape(1)});
  result["chi2_before"] = ToImmutableNumpy(std::move(output.chi2_before), {m});
  result["weights"] = ToImmutableNumpy(std::move(output.weights), {m});
  result["chi2_after"] = ToImmutableNumpy(std::move(output.chi2_after), {m});
  PutRecord(output, &result);
  return result;
}

std::vector<int32_t> PoseComponents(py::ssize_t num_poses, const Array<int32_t>& edges) {
  for (py::ssize_t k = 0; k < edges.size(); ++k) {
    const int32_t pose = edges.data()[k];
    if (pose < 0 || pose >= num_poses) throw InputError("edges: expected positions of poses");
  }
  return FindComponents(num_poses, edges.size() / 2, edges.data());
}

py::tuple HoldPosesFromPython(const py::object& graph) {
  const GraphArrays arrays(graph);
  const HeldPoses found = HoldPoses(arrays.poses.shape(0), arrays.edges.shape(0),
                                    arrays.edges.data(), arrays.fixed_data());
  const auto n = static_cast<py::ssize_t>(found.held.size());
  Array<bool> held(n);
  std::copy(found.held.begin(), found.held.end(), held.mutable_data());
  return py::make_tuple(held, found.num_components, found.for_gauge);
}

std::shared_ptr<PoseGraphEdges> PrepareEdgesFromPython(py::ssize_t num_poses,
                                                       const Array<int32_t>& edges,
                                                       const Array<double>& measurements,
                                                       const Array<double>& information) {
  const int dimension = measurements.shape(1) == Se2::kAmbient ? 2 : 3;
  return std::make_shared<PoseGraphEdges>(PrepareEdges(
      dimension, num_poses, edges.shape(0), edges.data(), measurements.data(), information.data()));
}

py::array EdgeChi2FromPython(const py::object& graph, const std::string& error,
                             const GraphArrays::Poses& poses) {
  const GraphArrays arrays(graph, poses);
  const PoseGraphView view = ViewWithErrors(arrays, arrays.fixed);
  PoseErrorOptions errors;
  errors.error = PoseErrorFromName(error);
  std::vector<double> chi2 = [&] {
    const ReleaseGil release;
    const PoseGraph made = MakePoseGraph(view, errors);
    return EdgeChi2(made, made.poses);
  }();
  return ToImmutableNumpy(std::move(chi2), {static_cast<py::ssize_t>(view.num_edges())});
}

/// The order of elimination, which the chordal start and the solves of one request share.
FillOrdering OrderPoses(const py::object& graph, const Array<bool>& held,
                        const std::string& ordering) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewGraph(arrays, held);
  const ReleaseGil release;
  const PoseGraph made = MakePoseGraph(view, {});
  return OrderEdges(made, view.tangent(), ordering);
}

py::array InitialPoses(const py::object& graph, const Array<bool>& held, const std::string& init,
                       int num_threads, const FillOrdering* order) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewGraph(arrays, held);
  // Only a chordal start uses information matrices; other starts work with invalid ones.
  const double* const information = arrays.information.data();
  PythonProgress report(py::none{});
  std::vector<double> poses = RunWatched(&report, [&] {
    const PoseGraph made = MakePoseGraph(view, {});
    if (init == "odometry") return Odometry(made, arrays.ids.data()).Poses();
    if (init == "spanning_tree") return SpanningTreePoses(made);
    if (init == "chordal") return ChordalPoses(made, information, num_threads, order);
    throw InputError("init: expected odometry, spanning_tree or chordal, found " + init);
  });
  const int n = view.ambient();
  for (int64_t i = 0; i < view.num_poses; ++i) {
    if (view.held[i] != 0) std::copy_n(view.poses + i * n, n, poses.begin() + i * n);
  }
  return ToImmutableNumpy(std::move(poses), {arrays.poses.shape(0), arrays.poses.shape(1)});
}

/// 1/2 r^T Omega r at the poses of odometry or of a spanning tree, or a sum above `limit`. Infinite
/// if the chain of odometry has a gap.
double StartCost(const py::object& graph, const Array<bool>& held, const std::string& init,
                 const std::string& error, double limit) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewWithErrors(arrays, held);
  PoseErrorOptions errors;
  errors.error = PoseErrorFromName(error);
  const ReleaseGil release;
  const PoseGraph made = MakePoseGraph(view, errors);
  if (init == "spanning_tree") return CostUpTo(made, SpanningTreePoses(made), limit);
  if (init != "odometry") {
    throw InputError("init: expected odometry or spanning_tree, found " + init);
  }
  const Odometry chain(made, arrays.ids.data());
  if (chain.Gap().first >= 0) return std::numeric_limits<double>::infinity();
  return CostUpTo(made, chain.Poses(), limit);
}

/// A flag per edge: true for a closure.
Array<bool> FindClosures(const Array<int64_t>& ids, const Array<int32_t>& edges) {
  const IdOrder order = OrderOfIds(ids.size(), ids.data());
  Array<bool> closures(edges.shape(0));
  const int32_t* const end = edges.data();
  for (py::ssize_t e = 0; e < edges.shape(0); ++e) {
    closures.mutable_data()[e] = IsClosure(order, ids.data(), end[2 * e], end[2 * e + 1]);
  }
  return closures;
}

std::pair<int32_t, int32_t> OdometryGap(const py::object& graph) {
  const GraphArrays arrays(graph);
  const PoseGraphView view = ViewGraph(arrays, arrays.fixed);
  const PoseGraph made = MakePoseGraph(view, {});
  return Odometry(made, arrays.ids.data()).Gap();
}

template <typename Group>
py::tuple EvaluateError(PoseError error, const Array<double>& x_i, const Array<double>& x_j,
                        const Array<double>& z) {
  constexpr int kSize = Group::kTangent;
  if (x_i.size() != Group::kAmbient || x_j.size() != Group::kAmbient ||
      z.size() != Group::kAmbient) {
    throw InputError("expected three poses of one kind");
  }
  Array<double> residual(kSize), right({kSize, kSize}), left({kSize, kSize});
  double adjoint[kSize * kSize], records[3][Group::kRecord];
  Group::Record(x_i.data(), records[0]);
  Group::Record(x_j.data(), records[1]);
  Group::Record(z.data(), records[2]);
  EvaluateRelativePose<Group>(error, records[0], records[1], records[2], residual.mutable_data(),
                              right.mutable_data(), adjoint);
  for (int r = 0; r < kSize; ++r) {
    for (int c = 0; c < kSize; ++c) {
      double sum = 0;
      for (int k = 0; k < kSize; ++k) sum -= right.data()[r * kSize + k] * adjoint[k * kSize + c];
      left.mutable_data()[r * kSize + c] = sum;
    }
  }
  return py::make_tuple(residual, left, right);
}

/// The error of a relative pose, not whitened, and its Jacobians by x_i and x_j.
py::tuple RelativePoseError(const std::string& error, const Array<double>& x_i,
                            const Array<double>& x_j, const Array<double>& z) {
  const PoseError kind = PoseErrorFromName(error);
  return z.size() == 3 ? EvaluateError<Se2>(kind, x_i, x_j, z)
                       : EvaluateError<Se3>(kind, x_i, x_j, z);
}

/// rho, rho', rho'' of a loss for edges.
std::vector<double> EvaluateEdgeLoss(const std::string& loss, double scale, double chi2) {
  std::vector<double> rho(3);
  ValueOfEdgeLoss(EdgeLossFromName(loss), scale, chi2, rho.data());
  return rho;
}

/// x of H x = b, with a block (d, d) per node and per edge; None if H is not positive definite.
py::object SolveEdgeSystemFromPython(const Array<int32_t>& edges, const Array<double>& diagonal,
                                     const Array<double>& between, const Array<double>& rhs) {
  const py::ssize_t n = rhs.shape(0), d = rhs.shape(1), m = edges.shape(0);
  if (diagonal.size() != n * d * d || between.size() != m * d * d || edges.size() != 2 * m) {
    throw InputError("expected a block for each node and each edge");
  }
  for (py::ssize_t e = 0; e < m; ++e) {
    const int32_t a = edges.data()[2 * e], b = edges.data()[2 * e + 1];
    if (a < 0 || b < 0 || a >= n || b >= n || a == b) {
      throw InputError("edges: expected two different nodes, 0 to " + std::to_string(n - 1));
    }
  }
  const EdgeSystem system{static_cast<int>(d), n,         m, edges.data(), diagonal.data(),
                          between.data(),      rhs.data()};
  std::vector<double> x = [&] {
    const ReleaseGil release;
    return SolveEdgeSystem(system);
  }();
  if (static_cast<py::ssize_t>(x.size()) != n * d) return py::none();
  return ToImmutableNumpy(std::move(x), {n, d});
}

}  // namespace
}  // namespace bundle

void BindPoseGraph(py::module_& m) {
  py::class_<bundle::FillOrdering>(m, "PoseOrder")
      .def_readonly("name", &bundle::FillOrdering::name)
      .def_readonly("entries", &bundle::FillOrdering::entries)
      .def_readonly("flops", &bundle::FillOrdering::elimination_flops);
  m.def("read_g2o", &bundle::ReadG2oFile, py::arg("path"));
  m.def("write_g2o", &bundle::WriteG2oFile, py::arg("path"), py::arg("graph"),
        py::arg("compression"));
  m.def("solve_pose_graph", &bundle::SolvePoseGraphFromPython, py::arg("graph"), py::arg("held"),
        py::arg("robust"), py::arg("options"), py::arg("progress"), py::arg("order") = nullptr,
        py::arg("with_trials") = false, py::arg("chi2") = py::none(),
        py::arg("poses") = py::none());
  m.def("order_poses", &bundle::OrderPoses, py::arg("graph"), py::arg("held"), py::arg("ordering"));
  m.def("pose_components", &bundle::PoseComponents, py::arg("num_poses"), py::arg("edges"));
  m.def("hold_poses", &bundle::HoldPosesFromPython, py::arg("graph"));
  py::class_<bundle::PoseGraphEdges, std::shared_ptr<bundle::PoseGraphEdges>>(m, "PoseGraphEdges")
      .def_readonly("bad", &bundle::PoseGraphEdges::bad)
      .def_readonly("has_information", &bundle::PoseGraphEdges::has_information);
  m.def("prepare_edges", &bundle::PrepareEdgesFromPython, py::arg("num_poses"), py::arg("edges"),
        py::arg("measurements"), py::arg("information"));
  m.def("edge_chi2", &bundle::EdgeChi2FromPython, py::arg("graph"), py::arg("error"),
        py::arg("poses") = py::none());
  m.def("initial_poses", &bundle::InitialPoses, py::arg("graph"), py::arg("held"), py::arg("init"),
        py::arg("num_threads"), py::arg("order") = nullptr);
  m.def("start_cost", &bundle::StartCost, py::arg("graph"), py::arg("held"), py::arg("init"),
        py::arg("error"), py::arg("limit"));
  m.def("find_closures", &bundle::FindClosures, py::arg("ids"), py::arg("edges"));
  m.def("odometry_gap", &bundle::OdometryGap, py::arg("graph"));
  m.def("solve_edge_system", &bundle::SolveEdgeSystemFromPython, py::arg("edges"),
        py::arg("diagonal"), py::arg("between"), py::arg("rhs"));
  m.def("edge_loss", &bundle::EvaluateEdgeLoss, py::arg("loss"), py::arg("scale"), py::arg("chi2"));
  m.def("relative_pose_error", &bundle::RelativePoseError, py::arg("error"), py::arg("x_i"),
        py::arg("x_j"), py::arg("z"));
}
