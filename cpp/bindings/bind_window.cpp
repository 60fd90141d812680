#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/python_progress.h"
#include "core/error.h"
#include "core/window/marginalize_window.h"
#include "core/window/solve_window.h"

namespace py = pybind11;

namespace bundle {
namespace {

/// The arrays of a window, and a view of them.
class WindowArrays {
 public:
  explicit WindowArrays(const py::dict& window) {
    view_.states = Numbers(window, "states", kStateNumbers, &view_.num_states);
    CheckSize(Numbers(window, "anchors", kStateNumbers), view_.num_states, "anchors");
    view_.anchors = doubles_.back().data();
    view_.anchored = Flags(window, "anchored", view_.num_states);
    const auto camera = py::cast<CastArray<double>>(window["camera_from_imu"]);
    if (camera.size() != 7) throw InputError("camera_from_imu: expected 7 numbers");
    std::copy_n(camera.data(), 7, view_.camera_from_imu.begin());
    view_.time_offset = py::cast<double>(window["time_offset"]);
    view_.refine_camera = py::cast<bool>(window["refine_camera"]);
    view_.refine_time_offset = py::cast<bool>(window["refine_time_offset"]);
    ReadLandmarks(window);
    ReadObservations(window);
    ReadInertia(window);
    for (const py::handle& prior : py::cast<py::sequence>(window["priors"])) {
      view_.priors.push_back(PriorFrom(py::cast<py::dict>(prior)));
    }
  }

  const WindowView& view() const { return view_; }

 private:
  const double* Numbers(const py::dict& window, const char* name, int columns,
                        int* rows = nullptr) {
    doubles_.push_back(py::cast<CastArray<double>>(window[name]));
    const CastArray<double>& array = doubles_.back();
    if (array.size() % columns != 0) {
      throw InputError(std::string(name) + ": expected rows of " + std::to_string(columns));
    }
    const double* const data = array.data();
    for (py::ssize_t k = 0; k < array.size(); ++k) {
      if (std::isfinite(data[k])) continue;
      throw InputError(std::string(name) + ": expected finite numbers, found infinity or nan at " +
                       std::to_string(k / columns));
    }
    if (rows != nullptr) *rows = static_cast<int>(array.size() / columns);
    last_rows_ = static_cast<int>(array.size() / columns);
    return data;
  }

  void CheckSize(const double* /*data*/, int expected, const char* name) const {
    if (last_rows_ != expected) {
      throw InputError(std::string(name) + ": expected " + std::to_string(expected) +
                       " rows, found " + std::to_string(last_rows_));
    }
  }

  const double* NumbersOf(const py::dict& window, const char* name, int columns, int rows) {
    const double* const data = Numbers(window, name, columns);
    CheckSize(data, rows, name);
    return data;
  }

  const uint8_t* Flags(const py::dict& window, const char* name, int count) {
    flags_.push_back(py::cast<CastArray<uint8_t>>(window[name]));
    if (flags_.back().size() != count) {
      throw InputError(std::string(name) + ": expected " + std::to_string(count) + " flags");
    }
    return flags_.back().data();
  }

  const int32_t* Indices(const py::dict& window, const char* name, int count, int limit) {
    indices_.push_back(py::cast<CastArray<int32_t>>(window[name]));
    const CastArray<int32_t>& array = indices_.back();
    if (array.size() != count) {
      throw InputError(std::string(name) + ": expected " + std::to_string(count) +
                       " indices, found " + std::to_string(array.size()));
    }
    for (int k = 0; k < count; ++k) {
      if (array.data()[k] >= 0 && array.data()[k] < limit) continue;
      throw InputError(std::string(name) + ": expected indices below " + std::to_string(limit) +
                       ", found " + std::to_string(array.data()[k]) + " at " + std::to_string(k));
    }
    return array.data();
  }

  void ReadLandmarks(const py::dict& window) {
    view_.points = Numbers(window, "points", 3, &view_.num_landmarks);
    const int n = view_.num_landmarks;
    view_.anchor_states = Indices(window, "anchor_states", n, view_.num_states);
    view_.anchor_xy = NumbersOf(window, "anchor_xy", 2, n);
    view_.anchor_velocity = NumbersOf(window, "anchor_velocity", 2, n);
  }

  void ReadObservations(const py::dict& window) {
    view_.xy = Numbers(window, "xy", 2, &view_.num_observations);
    const int k = view_.num_observations;
    view_.xy_velocity = NumbersOf(window, "xy_velocity", 2, k);
    view_.landmarks = Indices(window, "landmarks", k, view_.num_landmarks);
    view_.observers = Indices(window, "observers", k, view_.num_states);
    for (int i = 0; i < k; ++i) {
      if (i > 0 && view_.landmarks[i] < view_.landmarks[i - 1]) {
        throw InputError("landmarks: expected observations sorted by landmark");
      }
      if (view_.observers[i] == view_.anchor_states[view_.landmarks[i]]) {
        throw InputError("observers: expected other states than the anchor of landmark " +
                         std::to_string(view_.landmarks[i]));
      }
    }
    view_.sigma = py::cast<double>(window["sigma"]);
    view_.loss = LossFromName(py::cast<std::string>(window["loss"]));
    view_.loss_scale = py::cast<double>(window["loss_scale"]);
    if (!(view_.sigma > 0) || !(view_.loss_scale > 0)) {
      throw InputError("sigma, loss_scale: expected positive numbers");
    }
  }

  void ReadInertia(const py::dict& window) {
    const auto gravity = py::cast<CastArray<double>>(window["gravity"]);
    if (gravity.size() != 3) throw InputError("gravity: expected 3 numbers");
    std::copy_n(gravity.data(), 3, view_.gravity.begin());
    const auto imu = py::cast<py::sequence>(window["imu"]);
    if (static_cast<int>(imu.size()) != std::max(view_.num_states - 1, 0)) {
      throw InputError("imu: expected one motion between each two states");
    }
    for (const py::handle& samples : imu) {
      kept_.push_back(py::reinterpret_borrow<py::object>(samples));
      view_.imu.push_back(samples.is_none() ? nullptr : &py::cast<const Preintegration&>(samples));
    }
  }

  WindowPrior PriorFrom(const py::dict& given) const {
    WindowPrior prior;
    prior.blocks = py::cast<std::vector<int>>(given["blocks"]);
    const auto points = py::cast<CastArray<double>>(given["points"]);
    const auto matrix = py::cast<CastArray<double>>(given["matrix"]);
    const auto vector = py::cast<CastArray<double>>(given["vector"]);
    prior.points.assign(points.data(), points.data() + points.size());
    prior.matrix.assign(matrix.data(), matrix.data() + matrix.size());
    prior.vector.assign(vector.data(), vector.data() + vector.size());
    prior.is_square_root = py::cast<bool>(given["square_root"]);
    prior.constant = py::cast<double>(given["constant"]);
    prior.num_rows = static_cast<int>(prior.vector.size());
    size_t columns = 0;
    for (const int block : prior.blocks) {
      if (block < 0 || block >= view_.num_blocks()) {
        throw InputError("prior: expected blocks below " + std::to_string(view_.num_blocks()) +
                         ", found " + std::to_string(block));
      }
      columns += PriorBlockSize(block, view_.num_states);
    }
    if (prior.points.size() != kStateNumbers * prior.blocks.size() ||
        prior.matrix.size() != columns * prior.num_rows ||
        (!prior.is_square_root && columns != prior.vector.size())) {
      throw InputError("prior: expected " + std::to_string(columns) +
                       " columns, and one point per block");
    }
    return prior;
  }

  WindowView view_;
  int last_rows_ = 0;
  std::vector<CastArray<double>> doubles_;
  std::vector<CastArray<int32_t>> indices_;
  std::vector<CastArray<uint8_t>> flags_;
  std::vector<py::object> kept_;
};

py::dict PriorToPython(WindowPrior prior) {
  const auto rows = static_cast<py::ssize_t>(prior.num_rows);
  const auto blocks = static_cast<py::ssize_t>(prior.blocks.size());
  const auto columns = rows == 0 ? 0 : static_cast<py::ssize_t>(prior.matrix.size()) / rows;
  py::dict result;
  result["blocks"] = std::move(prior.blocks);
  result["points"] = ToImmutableNumpy(std::move(prior.points), {blocks, kStateNumbers});
  result["square_root"] = prior.is_square_root;
  result["matrix"] = ToImmutableNumpy(std::move(prior.matrix), {rows, columns});
  result["vector"] = ToImmutableNumpy(std::move(prior.vector), {rows});
  result["constant"] = prior.constant;
  return result;
}

py::dict CostsToPython(const WindowCosts& costs) {
  py::dict result;
  result["visual"] = costs.visual;
  result["imu"] = costs.imu;
  result["bias_walk"] = costs.bias_walk;
  result["prior"] = costs.prior;
  return result;
}

/// Smallest trust region radius of a step; None without steps. A record has the radius after its
/// step.
py::object LeastRadius(const std::vector<IterationRecord>& iterations) {
  if (iterations.size() < 2) return py::none();
  double least = iterations.front().trust_region_radius;
  for (size_t k = 1; k + 1 < iterations.size(); ++k) {
    least = std::min(least, iterations[k].trust_region_radius);
  }
  return py::float_(least);
}

py::dict SolveWindowFromPython(const py::dict& window, const py::dict& options,
                               const py::object& progress) {
  const WindowArrays arrays(window);
  WindowSolveOptions solve_options;
  solve_options.max_num_iterations = py::cast<int>(options["max_num_iterations"]);
  solve_options.time_budget = py::cast<double>(options["time_budget"]);
  solve_options.function_tolerance = py::cast<double>(options["function_tolerance"]);
  solve_options.spectrum = py::cast<bool>(options["spectrum"]);
  solve_options.covariance = py::cast<bool>(options["covariance"]);
  solve_options.expected_imu_cost = py::cast<bool>(options["expected_imu_cost"]);
  solve_options.fix_gauge = py::cast<bool>(options["fix_gauge"]);
  PythonProgress report(progress);
  WindowOutput output = RunWatched(
      &report, [&] { return SolveWindow(arrays.view(), solve_options, std::ref(report)); });
  report.Rethrow();
  const py::ssize_t n = arrays.view().num_states, m = arrays.view().num_landmarks;
  py::dict result;
  result["states"] = ToImmutableNumpy(std::move(output.state.states), {n, kStateNumbers});
  result["points"] = ToImmutableNumpy(std::move(output.state.points), {m, 3});
  result["camera_from_imu"] = output.state.camera_from_imu;
  result["time_offset"] = output.state.time_offset;
  result["costs_before"] = CostsToPython(output.before);
  result["costs_after"] = CostsToPython(output.after);
  result["termination_type"] = output.termination_type;
  result["message"] = output.message;
  result["out_of_time"] = output.out_of_time;
  result["interrupted"] = output.interrupted;
  result["num_iterations"] = static_cast<int>(output.iterations.size()) - 1;
  result["num_rejected"] = output.num_rejected;
  result["least_radius"] = LeastRadius(output.iterations);
  result["fill_ratio"] = output.fill_ratio;
  result["linearization_time"] = output.linearization_time;
  result["linear_solver_time"] = output.linear_solver_time;
  result["candidate_time"] = output.candidate_time;
  result["total_time"] = output.total_time;
  result["spectrum"] = output.spectrum;
  result["expected_imu_cost"] = output.expected_imu_cost;
  const auto k = static_cast<py::ssize_t>(output.residual_norms.size());
  result["residual_norms"] = ToImmutableNumpy(std::move(output.residual_norms), {k});
  if (output.covariance.empty()) {
    result["covariance"] = py::none();
  } else {
    result["covariance"] =
        ToImmutableNumpy(std::move(output.covariance), {kStateTangent, kStateTangent});
  }
  return result;
}

py::dict MarginalizeWindowFromPython(const py::dict& window, const py::dict& request) {
  const WindowArrays arrays(window);
  const WindowView& view = arrays.view();
  Marginalization marginalization;
  const auto flags = [&request](const char* name, size_t count) {
    const auto array = py::cast<CastArray<uint8_t>>(request[name]);
    if (static_cast<size_t>(array.size()) != count) {
      throw InputError(std::string(name) + ": expected " + std::to_string(count) + " flags");
    }
    return std::vector<uint8_t>(array.data(), array.data() + array.size());
  };
  marginalization.states = flags("states", view.num_states);
  marginalization.landmarks = flags("landmarks", view.num_landmarks);
  marginalization.imu = flags("imu", view.imu.size());
  marginalization.keep_points = py::cast<bool>(request["keep_points"]);
  marginalization.square_root = py::cast<bool>(request["square_root"]);
  marginalization.single_precision = py::cast<bool>(request["single_precision"]);
  MarginalizedWindow output = [&] {
    const ReleaseGil release;
    return MarginalizeWindow(view, marginalization);
  }();
  py::dict result;
  result["prior"] = PriorToPython(std::move(output.prior));
  result["asymmetry"] = output.asymmetry;
  result["least_cost"] = output.least_cost;
  result["num_landmarks"] = output.num_landmarks;
  result["num_landmarks_without_depth"] = output.num_landmarks_without_depth;
  result["is_regular"] = output.is_regular;
  return result;
}

/// The 15 coordinates of a state about a point.
std::vector<double> StateCoordinates(const CastArray<double>& point,
                                     const CastArray<double>& state) {
  if (point.size() != kStateNumbers || state.size() != kStateNumbers) {
    throw InputError("expected two states of 16 numbers");
  }
  std::vector<double> d(kStateTangent);
  StateFrom(point.data(), state.data(), d.data());
  return d;
}

py::array SpectrumOfMatrix(const CastArray<double>& matrix, bool square_root, bool scaled) {
  if (matrix.ndim() != 2 || (!square_root && matrix.shape(0) != matrix.shape(1))) {
    throw InputError("matrix: expected two dimensions, square unless it is a square root");
  }
  WindowPrior prior;
  prior.num_rows = static_cast<int>(matrix.shape(0));
  prior.is_square_root = square_root;
  prior.matrix.assign(matrix.data(), matrix.data() + matrix.size());
  std::vector<double> values = scaled ? ScaledSpectrumOfPrior(prior) : SpectrumOfPrior(prior);
  const auto size = static_cast<py::ssize_t>(values.size());
  return ToImmutableNumpy(std::move(values), {size});
}

}  // namespace
}  // namespace bundle

void BindWindow(py::module_& m) {
  m.def("solve_window", &bundle::SolveWindowFromPython, py::arg("window"), py::arg("options"),
        py::arg("progress"));
  m.def("marginalize_window", &bundle::MarginalizeWindowFromPython, py::arg("window"),
        py::arg("request"));
  m.def("state_coordinates", &bundle::StateCoordinates, py::arg("point"), py::arg("state"));
  m.def("prior_spectrum", &bundle::SpectrumOfMatrix, py::arg("matrix"), py::arg("square_root"),
        py::arg("scaled"));
}
