#pragma once

/// The arrays of a bundle.PoseGraph, as input of the core.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>

#include "core/error.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

template <typename T>
using Array = pybind11::array_t<T, pybind11::array::c_style>;

/// Arrays of a bundle.PoseGraph, which has checked shapes and values.
struct GraphArrays {
  explicit GraphArrays(const pybind11::handle& graph)
      : ids(pybind11::cast<Array<int64_t>>(graph.attr("ids"))),
        poses(pybind11::cast<Array<double>>(graph.attr("poses"))),
        fixed(pybind11::cast<Array<bool>>(graph.attr("fixed"))),
        edges(pybind11::cast<Array<int32_t>>(graph.attr("edges"))),
        measurements(pybind11::cast<Array<double>>(graph.attr("measurements"))),
        information(pybind11::cast<Array<double>>(graph.attr("information"))) {}

  int dimension() const { return poses.shape(1) == 3 ? 2 : 3; }
  const uint8_t* fixed_data() const { return reinterpret_cast<const uint8_t*>(fixed.data()); }

  Array<int64_t> ids;
  Array<double> poses;
  Array<bool> fixed;
  Array<int32_t> edges;
  Array<double> measurements;
  Array<double> information;
};

inline PoseError PoseErrorFromName(const std::string& name) {
  if (name == "log") return PoseError::kLog;
  if (name == "g2o") return PoseError::kG2o;
  if (name == "ceres") return PoseError::kCeres;
  throw InputError("error: expected log, g2o or ceres, found " + name);
}

/// The square roots of the information, which the graph keeps.
inline Array<double> RootsOf(const pybind11::handle& graph) {
  const pybind11::tuple found = graph.attr("information_roots");
  if (pybind11::len(found[1]) > 0) {
    throw InputError("information[" + std::string(pybind11::str(found[1][pybind11::int_(0)])) +
                     "]: expected a symmetric positive semidefinite matrix");
  }
  return pybind11::cast<Array<double>>(found[0]);
}

/// `held` may differ from the graph's array. `roots`: RootsOf; nullptr if errors are not evaluated.
inline PoseGraphView ViewGraph(const GraphArrays& arrays, const Array<bool>& held,
                               const Array<double>* roots = nullptr) {
  PoseGraphView view;
  view.dimension = arrays.dimension();
  view.num_poses = arrays.poses.shape(0);
  view.num_edges = arrays.edges.shape(0);
  view.poses = arrays.poses.data();
  view.held = reinterpret_cast<const uint8_t*>(held.data());
  view.edges = arrays.edges.data();
  view.measurements = arrays.measurements.data();
  if (roots != nullptr) view.roots = roots->data();
  if (held.size() != view.num_poses) throw InputError("held: expected a flag for each pose");
  return view;
}

}  // namespace bundle
