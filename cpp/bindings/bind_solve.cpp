#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <functional>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "core/backend/solve.h"
#include "core/ceres/solve_with_ceres.h"
#include "core/error.h"
#include "core/interruption.h"
#include "core/parallel_for.h"
#include "core/solve/convergence_watch.h"
#include "core/solve/option_names.h"

namespace py = pybind11;

namespace {

py::dict ToDict(const bundle::SolveSummary& s) {
  py::dict d;
#define BUNDLE_FIELD(name) d[#name] = s.name
  BUNDLE_FIELD(initial_cost);
  BUNDLE_FIELD(final_cost);
  BUNDLE_FIELD(fixed_cost);
  BUNDLE_FIELD(termination_type);
  BUNDLE_FIELD(message);
  BUNDLE_FIELD(is_solution_usable);
  BUNDLE_FIELD(num_successful_steps);
  BUNDLE_FIELD(num_unsuccessful_steps);
  BUNDLE_FIELD(num_parameter_blocks);
  BUNDLE_FIELD(num_parameters);
  BUNDLE_FIELD(num_residual_blocks);
  BUNDLE_FIELD(num_residuals);
  BUNDLE_FIELD(num_parameter_blocks_reduced);
  BUNDLE_FIELD(num_parameters_reduced);
  BUNDLE_FIELD(num_residual_blocks_reduced);
  BUNDLE_FIELD(num_residuals_reduced);
  BUNDLE_FIELD(trust_region_strategy_type);
  BUNDLE_FIELD(dogleg_type);
  BUNDLE_FIELD(linear_solver_type_given);
  BUNDLE_FIELD(linear_solver_type_used);
  BUNDLE_FIELD(schur_structure_given);
  BUNDLE_FIELD(schur_structure_used);
  BUNDLE_FIELD(preconditioner_type_given);
  BUNDLE_FIELD(preconditioner_type_used);
  BUNDLE_FIELD(dense_linear_algebra_library_type);
  BUNDLE_FIELD(sparse_linear_algebra_library_type);
  BUNDLE_FIELD(num_threads_given);
  BUNDLE_FIELD(num_threads_used);
  BUNDLE_FIELD(preprocessor_time_in_seconds);
  BUNDLE_FIELD(residual_evaluation_time_in_seconds);
  BUNDLE_FIELD(jacobian_evaluation_time_in_seconds);
  BUNDLE_FIELD(linear_solver_time_in_seconds);
  BUNDLE_FIELD(minimizer_time_in_seconds);
  BUNDLE_FIELD(postprocessor_time_in_seconds);
  BUNDLE_FIELD(total_time_in_seconds);
  BUNDLE_FIELD(num_residual_evaluations);
  BUNDLE_FIELD(num_jacobian_evaluations);
  BUNDLE_FIELD(num_linear_solves);
  BUNDLE_FIELD(backend_given);
  BUNDLE_FIELD(backend_used);
  BUNDLE_FIELD(backend_choice);
  BUNDLE_FIELD(instruction_set);
  BUNDLE_FIELD(linear_solver_choice);
  BUNDLE_FIELD(num_information_nonzeros);
  BUNDLE_FIELD(interrupted);
#undef BUNDLE_FIELD
  d["linear_solver_ordering_given"] = py::tuple(py::cast(s.linear_solver_ordering_given));
  d["linear_solver_ordering_used"] = py::tuple(py::cast(s.linear_solver_ordering_used));
  d["num_factor_columns"] = s.factor.num_columns;
  d["num_reduced_nonzeros"] = s.factor.num_reduced_nonzeros;
  d["num_factor_nonzeros"] = s.factor.num_nonzeros;
  d["factor_flops"] = s.factor.flops;
  d["factor_ordering"] = s.factor.ordering;
  d["symbolic_time_in_seconds"] = s.factor.symbolic_time_in_seconds;
  d["origin"] = s.origin.empty() ? py::object(py::none()) : py::tuple(py::cast(s.origin));
  py::list texts, kinds;
  for (const bundle::Warning& warning : s.warnings) {
    texts.append(warning.text);
    kinds.append(bundle::NameOf(warning.kind, bundle::kWarningKinds));
  }
  d["warnings"] = py::tuple(texts);
  d["warning_kinds"] = py::tuple(kinds);
  return d;
}

/// Calls visit(name, pointer to member) for each field of an iteration, in Ceres' order.
template <typename Visitor>
void VisitFields(const Visitor& visit) {
  using Record = bundle::IterationRecord;
  visit("iteration", &Record::iteration);
  visit("cost", &Record::cost);
  visit("cost_change", &Record::cost_change);
  visit("gradient_max_norm", &Record::gradient_max_norm);
  visit("step_norm", &Record::step_norm);
  visit("relative_decrease", &Record::relative_decrease);
  visit("trust_region_radius", &Record::trust_region_radius);
  visit("linear_solver_iterations", &Record::linear_solver_iterations);
  visit("step_is_successful", &Record::step_is_successful);
  visit("iteration_time_in_seconds", &Record::iteration_time_in_seconds);
  visit("cumulative_time_in_seconds", &Record::cumulative_time_in_seconds);
}

py::dict ToDict(const bundle::IterationRecord& record) {
  py::dict d;
  VisitFields([&](const char* name, auto field) { d[name] = record.*field; });
  return d;
}

/// One array a field.
py::dict ToArrays(const std::vector<bundle::IterationRecord>& records) {
  py::dict d;
  VisitFields([&](const char* name, auto field) {
    using T = std::decay_t<decltype(records[0].*field)>;
    py::array_t<T> array(static_cast<py::ssize_t>(records.size()));
    for (size_t i = 0; i < records.size(); ++i) array.mutable_data()[i] = records[i].*field;
    d[name] = array;
  });
  return d;
}

/// Takes the arrays of ToArrays, or sequences as long as each other.
std::string WatchConvergence(const py::dict& iterations) {
  std::vector<bundle::IterationRecord> records(py::len(iterations["iteration"]));
  VisitFields([&](const char* name, auto field) {
    using T = std::decay_t<decltype(records[0].*field)>;
    const auto values = py::cast<std::vector<T>>(iterations[name]);
    if (values.size() != records.size()) {
      throw bundle::InputError(std::string(name) + ": expected " + std::to_string(records.size()) +
                               " values, found " + std::to_string(values.size()));
    }
    for (size_t i = 0; i < records.size(); ++i) records[i].*field = values[i];
  });
  return bundle::WatchConvergence(records);
}

/// Tells Python of each iteration and looks for Ctrl-C. KeyboardInterrupt stops the solve, whether
/// a signal raised it or the callback, in which a signal may have done so. Any other exception, of
/// the callback or of a signal handler, stops it too and is kept: the first comes out in the end.
class PythonProgress {
 public:
  explicit PythonProgress(py::object callback) : callback_(std::move(callback)) {
    const py::module_ threading = py::module_::import("threading");
    sees_signals_ = threading.attr("current_thread")().is(threading.attr("main_thread")());
  }

  /// True if the solve is to go on. The callback sees the iteration even where Ctrl-C came first.
  bool operator()(const bundle::IterationRecord& record) {
    const py::gil_scoped_acquire acquire;
    if (!callback_.is_none()) {
      Guard([&] { callback_(ToDict(record)); });
    }
    LookForSignals();
    return !stopped_;
  }

  /// True if the solve is to stop within an iteration.
  bool IsInterrupted() {
    if (!sees_signals_) return stopped_;  // and no need to wait for the GIL
    const py::gil_scoped_acquire acquire;
    LookForSignals();
    return stopped_;
  }

  /// Raises what was kept. With the GIL.
  void Rethrow() {
    if (kept_) throw py::error_already_set(*kept_);
  }

 private:
  void LookForSignals() {
    Guard([] {
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    });
  }

  template <typename Function>
  void Guard(const Function& function) {
    try {
      function();
    } catch (const py::error_already_set& error) {
      stopped_ = true;
      if (!kept_ && !error.matches(PyExc_KeyboardInterrupt)) kept_ = error;
    }
  }

  py::object callback_;
  bool sees_signals_ = false;  ///< as Python handles them on its main thread alone
  bool stopped_ = false;
  std::optional<py::error_already_set> kept_;
};

/// Throws what the solver throws, unless Python raised something before.
bundle::SolveOutput SolveWatched(const bundle::ProblemView& view,
                                 const bundle::SolveOptions& options, PythonProgress* report) {
  try {
    const py::gil_scoped_release release;
    const bundle::InterruptionScope scope([report] { return report->IsInterrupted(); });
    return bundle::Solve(view, options, std::ref(*report));
  } catch (const bundle::Interrupted&) {  // with nothing to show for it yet
    report->Rethrow();
    PyErr_SetNone(PyExc_KeyboardInterrupt);
    throw py::error_already_set();
  } catch (...) {
    report->Rethrow();
    throw;
  }
}

py::dict Solve(const py::object& problem, const py::dict& options, const py::object& progress) {
  const bundle::ProblemView view = ViewProblem(problem);
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  PythonProgress report(progress);
  bundle::SolveOutput output = SolveWatched(view, solve_options, &report);
  report.Rethrow();
  py::dict result;
  const py::ssize_t num_images = view.num_images, num_cameras = view.num_cameras;
  const py::ssize_t num_points = view.num_points, stride = view.camera_params_stride;
  result["cam_from_world"] = ToImmutableNumpy(std::move(output.cam_from_world), {num_images, 7});
  result["camera_params"] =
      ToImmutableNumpy(std::move(output.camera_params), {num_cameras, stride});
  result["points"] = ToImmutableNumpy(std::move(output.points), {num_points, 3});
  result["summary"] = ToDict(output.summary);
  result["iterations"] = ToArrays(output.iterations);
  result["build_time_in_seconds"] = output.build_time_in_seconds;
  result["solve_time_in_seconds"] = output.solve_time_in_seconds;
  return result;
}

}  // namespace

void BindSolve(py::module_& m) {
  m.attr("CERES_VERSION") = bundle::CeresVersion();
  m.def("default_options", &DefaultOptions);
  m.def("option_choices", &OptionChoices);
  m.def("hardware_threads", [] { return bundle::EffectiveNumThreads(0); });
  m.def("watch_convergence", &WatchConvergence, py::arg("iterations"));
  m.def("solve", &Solve, py::arg("problem"), py::arg("options"), py::arg("progress"));
}
