#include "bindings/options_from_python.h"

#include <pybind11/stl.h>

#include <string>

#include "core/error.h"
#include "core/interface/options.h"

namespace py = pybind11;

namespace {

template <typename Enum, size_t kSize>
Enum ValueOf(const char* option, const std::string& text,
             const bundle::NamedValue<Enum> (&names)[kSize]) {
  for (const auto& [name, value] : names) {
    if (name == text) return value;
  }
  throw bundle::InputError(std::string(option) + ": unknown value " + text);
}

/// Calls visit for every option but `refine`: (name, value) or (name, value, names of its choices).
template <typename Options, typename Visitor>
void VisitOptions(Options& o, const Visitor& visit) {
  visit("backend", o.backend, bundle::kBackends);
  visit("linear_solver_type", o.linear_solver_type, bundle::kLinearSolverTypes);
  visit("linear_solver_ordering", o.linear_solver_ordering, bundle::kEliminationOrderings);
  visit("preconditioner_type", o.preconditioner_type, bundle::kPreconditionerTypes);
  visit("trust_region_strategy_type", o.trust_region_strategy_type, bundle::kTrustRegionStrategies);
  visit("loss", o.loss, bundle::kLossTypes);
  visit("loss_scale", o.loss_scale);
  visit("max_num_iterations", o.max_num_iterations);
  visit("function_tolerance", o.function_tolerance);
  visit("gradient_tolerance", o.gradient_tolerance);
  visit("parameter_tolerance", o.parameter_tolerance);
  visit("num_threads", o.num_threads);
  visit("deterministic", o.deterministic);
  visit("fixed_camera_ids", o.fixed_camera_ids);
  visit("fixed_image_ids", o.fixed_image_ids);
  visit("fixed_point_ids", o.fixed_point_ids);
  visit("refine_sensor_from_rig", o.refine_sensor_from_rig);
  visit("fixed_sensors", o.fixed_sensors);
  visit("gauge", o.gauge, bundle::kGauges);
  visit("cheirality", o.cheirality, bundle::kCheiralities);
  visit("check_solution", o.check_solution);
}

/// The names that `refine` may hold, each with its flag.
template <typename Options, typename Visitor>
void VisitRefine(Options& o, const Visitor& visit) {
  visit("poses", o.refine_poses);
  visit("points", o.refine_points);
  visit("focal", o.refine_focal);
  visit("principal_point", o.refine_principal_point);
  visit("extra", o.refine_extra);
}

struct Reader {
  const py::dict& options;

  template <typename T>
  void operator()(const char* name, T& value) const {
    value = py::cast<T>(options[name]);
  }

  template <typename Enum, size_t kSize>
  void operator()(const char* name, Enum& value,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    value = ValueOf(name, py::cast<std::string>(options[name]), names);
  }
};

struct Writer {
  py::dict& options;

  template <typename T>
  void operator()(const char* name, const T& value) const {
    options[name] = value;
  }

  template <typename Enum, size_t kSize>
  void operator()(const char* name, const Enum& value,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    options[name] = bundle::NameOf(value, names);
  }
};

struct ChoiceLister {
  py::dict& choices;

  template <typename T>
  void operator()(const char*, const T&) const {}

  template <typename Enum, size_t kSize>
  void operator()(const char* name, const Enum&,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    py::list list;
    for (const auto& [choice, value] : names) list.append(std::string(choice));
    choices[name] = list;
  }
};

constexpr double kLargestRadius = 1e16;  ///< of Levenberg-Marquardt: no damping to speak of

bool IsGaussNewton(const py::dict& options) {
  return py::cast<std::string>(options["trust_region_strategy_type"]) == "gauss_newton";
}

}  // namespace

bundle::LossType LossFromName(const std::string& name) {
  return ValueOf("loss", name, bundle::kLossTypes);
}

bundle::Cheirality CheiralityFromName(const std::string& name) {
  return ValueOf("cheirality", name, bundle::kCheiralities);
}

bundle::SolveOptions OptionsFromPython(const py::dict& options) {
  bundle::SolveOptions result;
  VisitOptions(result, Reader{options});
  const py::object refine = options["refine"];
  VisitRefine(result,
              [&](const char* name, bool& value) { value = refine.contains(py::str(name)); });
  return result;
}

void ReadPoseGraphOptions(const py::dict& options, bundle::SolveOptions* result) {
  const Reader read{options};
  read("backend", result->backend, bundle::kBackends);
  read("max_num_iterations", result->max_num_iterations);
  read("function_tolerance", result->function_tolerance);
  read("gradient_tolerance", result->gradient_tolerance);
  read("parameter_tolerance", result->parameter_tolerance);
  read("num_threads", result->num_threads);
  if (IsGaussNewton(options)) {
    result->initial_trust_region_radius = kLargestRadius;
  } else {
    read("trust_region_strategy_type", result->trust_region_strategy_type,
         bundle::kTrustRegionStrategies);
  }
}

bundle::SolveOptions GraphOptionsFromPython(const py::dict& options) {
  if (!IsGaussNewton(options)) return OptionsFromPython(options);
  const py::dict damped(options.attr("copy")());
  damped["trust_region_strategy_type"] = "levenberg_marquardt";
  bundle::SolveOptions result = OptionsFromPython(damped);
  result.initial_trust_region_radius = kLargestRadius;
  return result;
}

py::dict DefaultOptions() {
  const bundle::SolveOptions defaults;
  py::dict result;
  VisitOptions(defaults, Writer{result});
  py::list refine;
  VisitRefine(defaults, [&](const char* name, bool value) {
    if (value) refine.append(name);
  });
  result["refine"] = refine;
  return result;
}

py::dict OptionChoices() {
  const bundle::SolveOptions defaults;
  py::dict result;
  VisitOptions(defaults, ChoiceLister{result});
  return result;
}
