#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/given_problem.h"
#include "bindings/immutable_array.h"
#include "core/covariance/adjoint.h"
#include "core/covariance/covariance.h"
#include "core/covariance/influence.h"
#include "core/covariance/reliability.h"

namespace py = pybind11;

namespace {

/// Adds what all outputs have.
void PutSums(bundle::CovarianceOutput* from, py::dict* to) {
  py::dict& d = *to;
  d["weighted_squares"] = from->weighted_squares;
  d["num_residuals"] = from->num_residuals;
  d["num_parameters"] = from->num_parameters;
  d["predicted_decrease"] = from->predicted_decrease;
  d["gauge_degrees"] = from->gauge_degrees;
  const auto num_null = static_cast<py::ssize_t>(from->null_points.size());
  d["null_points"] = ToImmutableNumpy(std::move(from->null_points), {num_null});
  py::list warnings;
  for (const bundle::Warning& warning : from->warnings) warnings.append(warning.text);
  d["warnings"] = warnings;
}

py::dict Covariance(const py::object& problem, const py::dict& options,
                    const py::object& restrictions, const py::object& factors, bool inner,
                    bool sandwich, bool of_points, const std::vector<std::pair<int, int>>& relative,
                    bool long_sums, bool of_images,
                    const std::optional<CastArray<double>>& functions,
                    const std::vector<int>& function_points,
                    const std::optional<CastArray<double>>& functions_of_points) {
  GivenProblem given(problem, options, restrictions, factors);
  const bundle::AdjustmentProblem& view = given.view();
  bundle::CovarianceOptions wanted;
  wanted.inner = inner;
  wanted.sandwich = sandwich;
  wanted.of_points = of_points;
  wanted.of_images = of_images;
  if (functions) wanted.functions.assign(functions->data(), functions->data() + functions->size());
  wanted.function_points = function_points;
  if (functions_of_points) {
    wanted.functions_of_points.assign(functions_of_points->data(),
                                      functions_of_points->data() + functions_of_points->size());
  }
  wanted.long_sums = long_sums;
  wanted.relative = relative;
  bundle::CovarianceOutput output = given.Run(
      [&](const auto& p, const auto& o) { return bundle::ComputeCovariance(p, o, wanted); });
  const py::ssize_t images = view.num_images, frames = view.num_frames, sensors = view.num_sensors,
                    cameras = view.num_cameras, points = view.num_points,
                    stride = view.camera_params_stride;
  const auto count = [](const auto& v) { return static_cast<py::ssize_t>(v.size()); };
  py::dict d;
  d["steps"] = ToImmutableNumpy(std::move(output.steps), {images, 6});
  const py::ssize_t num_functions = functions ? functions->shape(0) : 0;
  d["functions"] = ToImmutableNumpy(std::move(output.functions), {num_functions, num_functions});
  PutSums(&output, &d);
  if (!of_images) return d;
  d["poses"] = ToImmutableNumpy(std::move(output.poses), {images, 6, 6});
  d["frames"] = ToImmutableNumpy(std::move(output.frames), {frames, 6, 6});
  d["sensors"] = ToImmutableNumpy(std::move(output.sensors), {sensors, 6, 6});
  d["cameras"] = ToImmutableNumpy(std::move(output.cameras), {cameras, stride, stride});
  if (!output.twists.empty()) {
    d["twists"] = ToImmutableNumpy(std::move(output.twists), {images, 6, 6});
    d["readouts"] = ToImmutableNumpy(std::move(output.readouts), {cameras});
  }
  if (of_points) d["points"] = ToImmutableNumpy(std::move(output.points), {points, 3, 3});
  d["relative"] = ToImmutableNumpy(std::move(output.relative), {count(relative), 6, 6});
  return d;
}

py::dict Reliability(const py::object& problem, const py::dict& options,
                     const py::object& restrictions, const py::object& factors, double least,
                     int num_worst, bool long_sums) {
  GivenProblem given(problem, options, restrictions, factors);
  const py::ssize_t n = given.view().num_observations;
  const bundle::ReliabilityOptions wanted{least, num_worst, long_sums};
  bundle::ReliabilityOutput output = given.Run(
      [&](const auto& p, const auto& o) { return bundle::ComputeReliability(p, o, wanted); });
  py::dict d;
  const auto count = [](const auto& v) { return static_cast<py::ssize_t>(v.size()); };
  d["residuals"] = ToImmutableNumpy(std::move(output.residuals), {n, 2});
  d["leverages"] = ToImmutableNumpy(std::move(output.leverages), {n, 3});
  d["weights"] = ToImmutableNumpy(std::move(output.weights), {n});
  d["least"] = ToImmutableNumpy(std::move(output.least), {n});
  d["along"] = ToImmutableNumpy(std::move(output.along), {n, 2});
  const py::ssize_t m = count(output.factor_redundancy);
  d["factor_measurements"] = ToImmutableNumpy(std::move(output.factor_measurements), {m});
  d["factor_redundancy"] = ToImmutableNumpy(std::move(output.factor_redundancy), {m});
  d["factor_least"] = ToImmutableNumpy(std::move(output.factor_least), {m});
  d["factor_test"] = ToImmutableNumpy(std::move(output.factor_test), {m});
  d["factor_rank"] = ToImmutableNumpy(std::move(output.factor_rank), {m});
  py::list worst;
  for (const bundle::ExternalEffect& one : output.worst) {
    worst.append(
        py::make_tuple(one.observation, one.point, one.point_sigmas, one.image, one.image_sigmas));
  }
  d["worst"] = worst;
  PutSums(&output.sums, &d);
  return d;
}

/// Derivatives with one row per image, camera and point of a problem, which is checked here.
bundle::InfluenceOptions Derivatives(const bundle::AdjustmentProblem& view,
                                     const CastArray<double>& images,
                                     const CastArray<double>& cameras,
                                     const CastArray<double>& points) {
  if (images.size() != 6 * py::ssize_t{view.num_images} ||
      cameras.size() != py::ssize_t{view.num_cameras} * view.camera_params_stride ||
      points.size() != 3 * py::ssize_t{view.num_points}) {
    throw bundle::InputError("gradient: expected a row per image, camera and point");
  }
  const auto values = [](const CastArray<double>& array) {
    return std::vector<double>(array.data(), array.data() + array.size());
  };
  return {values(images), values(cameras), values(points)};
}

/// `without`: "observations" or "points", whose deletions are wanted; other words: none.
py::dict Influence(const py::object& problem, const py::dict& options,
                   const py::object& restrictions, const py::object& factors,
                   const std::string& without, const CastArray<double>& images,
                   const CastArray<double>& cameras, const CastArray<double>& points) {
  GivenProblem given(problem, options, restrictions, factors);
  const py::ssize_t n = given.view().num_observations;
  const bundle::InfluenceOptions gradient = Derivatives(given.view(), images, cameras, points);
  const bundle::Deletions wanted = without == "observations" ? bundle::Deletions::kObservations
                                   : without == "points"     ? bundle::Deletions::kPoints
                                                             : bundle::Deletions::kNone;
  bundle::InfluenceOutput output = given.Run([&](const auto& p, const auto& o) {
    return bundle::ComputeInfluence(p, o, gradient, wanted);
  });
  const auto count = [](const auto& v) { return static_cast<py::ssize_t>(v.size()); };
  const py::ssize_t m = count(output.factor_share), num_without = count(output.without);
  py::dict d;
  d["variance"] = output.variance;
  d["step"] = output.step;
  d["gauge_share"] = output.gauge_share;
  d["along"] = ToImmutableNumpy(std::move(output.along), {n, 2});
  d["weights"] = ToImmutableNumpy(std::move(output.weights), {n});
  d["without"] = ToImmutableNumpy(std::move(output.without), {num_without});
  d["factor_share"] = ToImmutableNumpy(std::move(output.factor_share), {m});
  PutSums(&output.sums, &d);
  return d;
}

/// An AdjointSystem with its problem and factors, all of which it keeps alive.
class PythonAdjoint {
 public:
  /// `factors`: those of the gradient; `eliminated`: those of them that the factorisation has.
  PythonAdjoint(py::object problem, const py::dict& options, py::object restrictions,
                const py::object& factors, const py::object& eliminated, bool exact)
      : problem_(std::move(problem)),
        restrictions_(std::move(restrictions)),
        given_(problem_, options, restrictions_, eliminated),
        factors_(factors),
        system_(given_.Run([&](const auto& p, const auto& o) {
          return bundle::AdjointSystem::Make(p, factors_.Check(), o, exact);
        })) {}

  bool is_exact() const { return system_->is_exact(); }
  py::object Held() const { return ToImmutableNumpy(system_->Held(), {num_cameras(), stride()}); }

  py::tuple Directions() const {
    const py::ssize_t size = system_->size(), degrees = system_->degrees();
    const auto count = static_cast<size_t>(size * degrees);
    std::vector<double> n(count), of_sums(count);
    system_->Directions(n.data(), of_sums.data());
    return py::make_tuple(ToImmutableNumpy(std::move(n), {degrees, size}),
                          ToImmutableNumpy(std::move(of_sums), {degrees, size}));
  }

  py::object Solve(const CastArray<double>& y) {
    std::vector<double> a(Checked(y).size());
    Run([&] { system_->Solve(y.data(), a.data()); });
    return Vector(std::move(a));
  }

  py::object Gather(const CastArray<double>& images, const CastArray<double>& cameras,
                    const CastArray<double>& points) const {
    return Vector(system_->Gather(Derivatives(given_.view(), images, cameras, points)));
  }

  py::object Gradient(const CastArray<double>& step) {
    std::vector<double> gradient(Checked(step).size());
    Run([&] { system_->Gradient(step.data(), gradient.data()); });
    return Vector(std::move(gradient));
  }

  py::dict Product(const CastArray<double>& a, double e) {
    Checked(a);
    bundle::AdjointRows rows;
    Run([&] { rows = system_->Product(a.data(), e); });
    const py::ssize_t n = given_.view().num_observations;
    py::dict d;
    d["product"] = Vector(std::move(rows.product));
    d["by_params"] = ToImmutableNumpy(std::move(rows.by_params), {num_cameras(), stride()});
    d["along"] = ToImmutableNumpy(std::move(rows.along), {n, 2});
    d["residuals"] = ToImmutableNumpy(std::move(rows.residuals), {n, 2});
    d["weights"] = ToImmutableNumpy(std::move(rows.weights), {n});
    d["bends"] = ToImmutableNumpy(std::move(rows.bends), {n});
    d["factor_begin"] = rows.factor_begin;
    d["factor_along"] = Vector(std::move(rows.factor_along));
    d["factor_residuals"] = Vector(std::move(rows.factor_residuals));
    d["factor_weights"] = Vector(std::move(rows.factor_weights));
    d["factor_bends"] = Vector(std::move(rows.factor_bends));
    return d;
  }

  /// The arrays of the moved problem, by the names of model/estimates.py.
  py::dict Moved(const CastArray<double>& step) {
    Checked(step);
    bundle::SolveOutput output;
    Run([&] { output = system_->Moved(step.data()); });
    const bundle::AdjustmentProblem& view = given_.view();
    const py::ssize_t images = view.num_images, points = view.num_points;
    const py::ssize_t frames = view.num_frames, sensors = view.num_sensors;
    py::dict d;
    d["cam_from_world"] = ToImmutableNumpy(std::move(output.cam_from_world), {images, 7});
    d["camera_params"] =
        ToImmutableNumpy(std::move(output.camera_params), {num_cameras(), stride()});
    d["points"] = ToImmutableNumpy(std::move(output.points), {points, 3});
    if (frames > 0) {
      d["rig_from_world"] = ToImmutableNumpy(std::move(output.rig_from_world), {frames, 7});
      d["sensor_from_rig"] = ToImmutableNumpy(std::move(output.sensor_from_rig), {sensors, 7});
    }
    if (!output.twists.empty()) {
      d["twist"] = ToImmutableNumpy(std::move(output.twists), {images, 6});
      d["readout"] = ToImmutableNumpy(std::move(output.readouts), {num_cameras()});
    }
    return d;
  }

 private:
  py::ssize_t num_cameras() const { return given_.view().num_cameras; }
  py::ssize_t stride() const { return given_.view().camera_params_stride; }

  const CastArray<double>& Checked(const CastArray<double>& vector) const {
    if (vector.size() == system_->size()) return vector;
    throw bundle::InputError("adjoint: expected " + std::to_string(system_->size()) +
                             " numbers, found " + std::to_string(vector.size()));
  }

  static py::object Vector(std::vector<double> values) {
    const auto size = static_cast<py::ssize_t>(values.size());
    return ToImmutableNumpy(std::move(values), {size});
  }

  template <typename Compute>
  static void Run(const Compute& compute) {
    PythonProgress watch{py::none()};
    RunWatched(&watch, compute);
    watch.Rethrow();
  }

  const py::object problem_;
  const py::object restrictions_;
  GivenProblem given_;
  GivenFactors factors_;
  const std::unique_ptr<bundle::AdjointSystem> system_;
};

}  // namespace

void BindCovariance(py::module_& m) {
  m.def("covariance", &Covariance, py::arg("problem"), py::arg("options"), py::arg("restrictions"),
        py::arg("factors"), py::arg("inner"), py::arg("sandwich"), py::arg("of_points"),
        py::arg("relative"), py::arg("long_sums"), py::arg("of_images") = true,
        py::arg("functions") = py::none(), py::arg("function_points") = std::vector<int>(),
        py::arg("functions_of_points") = py::none());
  m.def("reliability", &Reliability, py::arg("problem"), py::arg("options"),
        py::arg("restrictions"), py::arg("factors"), py::arg("least"), py::arg("num_worst"),
        py::arg("long_sums") = true);
  m.def("influence", &Influence, py::arg("problem"), py::arg("options"), py::arg("restrictions"),
        py::arg("factors"), py::arg("without"), py::arg("images"), py::arg("cameras"),
        py::arg("points"));
  py::class_<PythonAdjoint>(m, "Adjoint")
      .def(py::init<py::object, const py::dict&, py::object, const py::object&, const py::object&,
                    bool>(),
           py::arg("problem"), py::arg("options"), py::arg("restrictions"), py::arg("factors"),
           py::arg("eliminated"), py::arg("exact"))
      .def_property_readonly("held", &PythonAdjoint::Held)
      .def_property_readonly("is_exact", &PythonAdjoint::is_exact)
      .def("directions", &PythonAdjoint::Directions)
      .def("solve", &PythonAdjoint::Solve, py::arg("y"))
      .def("gather", &PythonAdjoint::Gather, py::arg("images"), py::arg("cameras"),
           py::arg("points"))
      .def("gradient", &PythonAdjoint::Gradient, py::arg("step"))
      .def("product", &PythonAdjoint::Product, py::arg("a"), py::arg("e"))
      .def("moved", &PythonAdjoint::Moved, py::arg("step"));
}
