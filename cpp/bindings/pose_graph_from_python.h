#pragma once

/// The arrays of a bundle.PoseGraph, as input of the core.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "bindings/arrays.h"
#include "core/error.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Arrays of a bundle.PoseGraph, which has checked shapes and values; `given` replaces its poses.
struct GraphArrays {
  using Poses = std::optional<Array<double>>;

  explicit GraphArrays(const pybind11::handle& graph, const Poses& given = {})
      : ids(pybind11::cast<Array<int64_t>>(graph.attr("ids"))),
        poses(pybind11::cast<Array<double>>(graph.attr("poses"))),
        fixed(pybind11::cast<Array<bool>>(graph.attr("fixed"))),
        edges(pybind11::cast<Array<int32_t>>(graph.attr("edges"))),
        measurements(pybind11::cast<Array<double>>(graph.attr("measurements"))),
        information(pybind11::cast<Array<double>>(graph.attr("information"))),
        prepared(pybind11::cast<std::shared_ptr<PoseGraphEdges>>(graph.attr("prepared_edges"))) {
    if (!given) return;
    if (given->ndim() != 2 || given->shape(0) != poses.shape(0) ||
        given->shape(1) != poses.shape(1)) {
      throw InputError("poses: expected an array of the shape of the graph's poses");
    }
    poses = *given;
  }

  int dimension() const { return poses.shape(1) == 3 ? 2 : 3; }
  const uint8_t* fixed_data() const { return reinterpret_cast<const uint8_t*>(fixed.data()); }

  Array<int64_t> ids;
  Array<double> poses;
  Array<bool> fixed;
  Array<int32_t> edges;
  Array<double> measurements;
  Array<double> information;
  std::shared_ptr<const PoseGraphEdges> prepared;
};

inline PoseError PoseErrorFromName(const std::string& name) {
  if (name == "log") return PoseError::kLog;
  if (name == "g2o") return PoseError::kG2o;
  if (name == "ceres") return PoseError::kCeres;
  throw InputError("error: expected log, g2o or ceres, found " + name);
}

/// `held` may differ from the graph's array.
inline PoseGraphView ViewGraph(const GraphArrays& arrays, const Array<bool>& held) {
  PoseGraphView view;
  view.num_poses = arrays.poses.shape(0);
  view.poses = arrays.poses.data();
  view.held = reinterpret_cast<const uint8_t*>(held.data());
  view.edges = arrays.prepared;
  if (held.size() != view.num_poses) throw InputError("held: expected a flag for each pose");
  return view;
}

/// A view whose errors can be evaluated.
inline PoseGraphView ViewWithErrors(const GraphArrays& arrays, const Array<bool>& held) {
  if (!arrays.prepared->bad.empty()) {
    throw InputError("information[" + std::to_string(arrays.prepared->bad.front()) +
                     "]: expected a symmetric positive semidefinite matrix");
  }
  return ViewGraph(arrays, held);
}

}  // namespace bundle
