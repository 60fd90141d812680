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
#include "bindings/given_factors.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/python_communicator.h"
#include "bindings/python_progress.h"
#include "bindings/summary_to_python.h"
#include "core/ceres/solve_with_ceres.h"
#include "core/checking/convergence_watch.h"
#include "core/error.h"
#include "core/parallel/thread_pool.h"
#include "core/solver/solver.h"
#include "core/sums/double_double.h"
#include "core/sums/point_sections.h"

namespace py = pybind11;

namespace {

std::string WatchConvergence(const py::dict& iterations, const std::string& advice) {
  return bundle::WatchConvergence(RecordsFromPython(iterations), advice);
}

py::dict ToPython(const bundle::ProblemView& view, bundle::SolveOutput output) {
  py::dict result;
  const py::ssize_t num_images = view.num_images, num_cameras = view.num_cameras;
  const py::ssize_t num_points = view.num_points, stride = view.camera_params_stride;
  result["cam_from_world"] = ToImmutableNumpy(std::move(output.cam_from_world), {num_images, 7});
  if (view.num_frames > 0) {
    const py::ssize_t num_frames = view.num_frames, num_sensors = view.num_sensors;
    result["rig_from_world"] = ToImmutableNumpy(std::move(output.rig_from_world), {num_frames, 7});
    result["sensor_from_rig"] =
        ToImmutableNumpy(std::move(output.sensor_from_rig), {num_sensors, 7});
  }
  result["camera_params"] =
      ToImmutableNumpy(std::move(output.camera_params), {num_cameras, stride});
  result["points"] = ToImmutableNumpy(std::move(output.points), {num_points, 3});
  if (!output.twists.empty()) {
    result["twist"] = ToImmutableNumpy(std::move(output.twists), {num_images, 6});
    result["readout"] = ToImmutableNumpy(std::move(output.readouts), {num_cameras});
  }
  const auto num_factors = static_cast<py::ssize_t>(output.factor_costs_after.size());
  result["factor_costs_before"] =
      ToImmutableNumpy(std::move(output.factor_costs_before), {num_factors});
  result["factor_costs_after"] =
      ToImmutableNumpy(std::move(output.factor_costs_after), {num_factors});
  PutRecord(output, &result);
  return result;
}

py::dict Solve(const py::object& problem, const py::dict& options, const py::object& progress,
               const py::object& restrictions, const py::object& given_factors) {
  bundle::AdjustmentProblem view(ViewProblem(problem));
  view.restrictions = ViewRestrictions(restrictions, view);
  GivenFactors factors(given_factors);
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  PythonProgress report(progress);
  bundle::SolveOutput output = RunWatched(&report, [&] {
    view.factors = factors.Check();
    return bundle::Solve(view, solve_options, std::ref(report));
  });
  report.Rethrow();
  return ToPython(view, std::move(output));
}

/// One rank's part of a solve. `problem` has the rank's points, their sections and their
/// observations; `image_is_observed` refers to all ranks. Python handles signals; exceptions of its
/// handlers are raised at the next communication between ranks.
py::dict SolvePart(const py::object& problem, const py::dict& options, const py::object& progress,
                   const py::object& restrictions, const py::object& given_factors,
                   const py::object& ranks, const py::array_t<uint8_t>& image_is_observed) {
  bundle::AdjustmentProblem view(ViewProblem(problem));
  view.restrictions = ViewRestrictions(restrictions, view);
  GivenFactors factors(given_factors);
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  if (image_is_observed.size() != view.num_images) {
    throw bundle::InputError("image_is_observed: expected one entry per image");
  }
  PythonCommunicator communicator(ranks);
  view.division.communicator = &communicator;
  view.division.image_is_observed = image_is_observed.data();
  const auto section = py::cast<CastArray<uint16_t>>(problem.attr("point_section"));
  if (section.size() != view.num_points) {
    throw bundle::InputError("point_section: expected one entry per point");
  }
  view.division.point_section = section.data();
  PythonProgress report(progress);
  bundle::SolveOutput output = [&] {
    const ReleaseGil release;
    view.factors = factors.Check();
    return bundle::Solve(view, solve_options, std::ref(report));
  }();
  report.Rethrow();
  return ToPython(view, std::move(output));
}

/// Adds double-doubles to other double-doubles, in place.
void AddDoubleDouble(const Array<double>& sums, const Array<double>& errors, Array<double> to_sums,
                     Array<double> to_errors) {
  const py::ssize_t count = sums.size();
  if (errors.size() != count || to_sums.size() != count || to_errors.size() != count) {
    throw bundle::InputError("add_double_doubles: expected four arrays of one size");
  }
  double* const sum = to_sums.mutable_data();
  double* const error = to_errors.mutable_data();
  for (py::ssize_t i = 0; i < count; ++i) {
    bundle::AddDoubleDouble(sums.data()[i], sum + i, error + i);
    error[i] += errors.data()[i];
  }
}

/// A solver with its problem, restrictions and factors, all of which it keeps alive. Python code
/// cannot change the arrays of the problem and the restrictions.
class PythonSolver {
 public:
  PythonSolver(py::object problem, const py::dict& options, py::object restrictions,
               const py::object& given_factors)
      : problem_(std::move(problem)),
        restrictions_(std::move(restrictions)),
        factors_(given_factors),
        options_(OptionsFromPython(options)) {
    bundle::AdjustmentProblem view(ViewProblem(problem_));
    view.restrictions = ViewRestrictions(restrictions_, view);
    PythonProgress watch{py::none()};
    solver_ = RunWatched(&watch, [&] {
      view.factors = factors_.Check();
      return std::make_unique<bundle::Solver>(view, options_);
    });
    watch.Rethrow();
  }

  void CheckStructure(const py::object& problem) const {
    solver_->CheckStructure(ViewProblem(problem));
  }

  py::dict Solve(const py::object& problem, const py::dict& options, const py::object& progress) {
    const bundle::AdjustmentProblem view(ViewProblem(problem));
    const bundle::SolveOptions changed = OptionsFromPython(options);
    PythonProgress report(progress);
    bundle::SolveOutput output = RunWatched(&report, [&] {
      if (!factors_.empty()) {
        solver_->CheckStructure(view);
        factors_.CheckAt(view);
      }
      return solver_->Solve(view, changed, std::ref(report));
    });
    report.Rethrow();
    return ToPython(view, std::move(output));
  }

 private:
  const py::object problem_;
  const py::object restrictions_;
  GivenFactors factors_;
  const bundle::SolveOptions options_;
  std::unique_ptr<bundle::Solver> solver_;
};

}  // namespace

void BindSolve(py::module_& m) {
  m.attr("CERES_VERSION") = bundle::CeresVersion();
  m.def("changeable_options", &ChangeableOptions);
  m.def("default_options", &DefaultOptions);
  m.def("option_choices", &OptionChoices);
  m.def("hardware_threads", [] {
    static const int threads = bundle::EffectiveNumThreads(0);  // reads a file of the system
    return threads;
  });
  m.def(
      "reason_for_ceres",
      [](const py::dict& options) { return bundle::ReasonForCeres(OptionsFromPython(options)); },
      py::arg("options"));
  m.def("watch_convergence", &WatchConvergence, py::arg("iterations"), py::arg("advice"));
  m.def("solve", &Solve, py::arg("problem"), py::arg("options"), py::arg("progress"),
        py::arg("restrictions") = py::none(), py::arg("factors") = py::none());
  m.def("solve_part", &SolvePart, py::arg("problem"), py::arg("options"), py::arg("progress"),
        py::arg("restrictions"), py::arg("factors"), py::arg("ranks"),
        py::arg("image_is_observed"));
  m.def("num_point_sections", &bundle::NumPointSections, py::arg("num_observations"));
  m.def("add_double_doubles", &AddDoubleDouble, py::arg("sums"), py::arg("errors"),
        py::arg("to_sums").noconvert(), py::arg("to_errors").noconvert());
  py::class_<PythonSolver>(m, "Solver")
      .def(py::init<py::object, const py::dict&, py::object, const py::object&>(),
           py::arg("problem"), py::arg("options"), py::arg("restrictions") = py::none(),
           py::arg("factors") = py::none())
      .def("check_structure", &PythonSolver::CheckStructure, py::arg("problem"))
      .def("solve", &PythonSolver::Solve, py::arg("problem"), py::arg("options"),
           py::arg("progress"));
}
