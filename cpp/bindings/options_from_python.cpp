#include "bindings/options_from_python.h"

#include <pybind11/stl.h>

#include <algorithm>
#include <iterator>
#include <string>
#include <string_view>

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

/// Reads one option from Python, with the arguments of VisitOptions.
class Reader {
 public:
  Reader(const py::dict& options, bundle::SolveOptions* result)
      : options_(options), result_(result) {}

  template <typename T>
  void operator()(bundle::Change /*change*/, const char* name,
                  T bundle::SolveOptions::* member) const {
    result_->*member = py::cast<T>(options_[name]);
  }

  template <typename Enum, size_t kSize>
  void operator()(bundle::Change /*change*/, const char* name, Enum bundle::SolveOptions::* member,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    result_->*member = ValueOf(name, py::cast<std::string>(options_[name]), names);
  }

 private:
  const py::dict& options_;
  bundle::SolveOptions* const result_;
};

/// Writes the default of one option for Python.
struct Writer {
  py::dict& options;

  template <typename T>
  void operator()(bundle::Change /*change*/, const char* name,
                  T bundle::SolveOptions::* member) const {
    options[name] = bundle::SolveOptions().*member;
  }

  template <typename Enum, size_t kSize>
  void operator()(bundle::Change /*change*/, const char* name, Enum bundle::SolveOptions::* member,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    options[name] = bundle::NameOf(bundle::SolveOptions().*member, names);
  }
};

/// Lists the choices of one option.
struct ChoiceLister {
  py::dict& choices;

  template <typename T>
  void operator()(bundle::Change /*change*/, const char* /*name*/,
                  T bundle::SolveOptions::* /*member*/) const {}

  template <typename Enum, size_t kSize>
  void operator()(bundle::Change /*change*/, const char* name,
                  Enum bundle::SolveOptions::* /*member*/,
                  const bundle::NamedValue<Enum> (&names)[kSize]) const {
    py::list list;
    for (const auto& [choice, value] : names) list.append(std::string(choice));
    choices[name] = list;
  }
};

/// The options that pose graphs share with other problems.
constexpr std::string_view kPoseGraphOptions[] = {"backend",
                                                  "max_num_iterations",
                                                  "function_tolerance",
                                                  "gradient_tolerance",
                                                  "parameter_tolerance",
                                                  "num_threads"};

constexpr double kLargestRadius = 1e16;  ///< radius of Levenberg-Marquardt with negligible damping

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
  bundle::VisitOptions(Reader(options, &result));
  const py::object refine = options["refine"];
  bundle::VisitRefine([&](const char* name, bool bundle::SolveOptions::* member) {
    result.*member = refine.contains(py::str(name));
  });
  return result;
}

void ReadPoseGraphOptions(const py::dict& options, bundle::SolveOptions* result) {
  const Reader read(options, result);
  const bool is_gauss_newton = IsGaussNewton(options);
  bundle::VisitOptions(
      [&](bundle::Change change, const char* name, auto member, const auto&... choices) {
        const bool is_strategy = std::string_view(name) == "trust_region_strategy_type";
        const bool is_common = std::find(std::begin(kPoseGraphOptions), std::end(kPoseGraphOptions),
                                         name) != std::end(kPoseGraphOptions);
        if (is_common || (is_strategy && !is_gauss_newton)) read(change, name, member, choices...);
      });
  if (is_gauss_newton) result->initial_trust_region_radius = kLargestRadius;
}

bundle::SolveOptions GraphOptionsFromPython(const py::dict& options) {
  if (!IsGaussNewton(options)) return OptionsFromPython(options);
  const py::dict damped(options.attr("copy")());
  damped["trust_region_strategy_type"] = "levenberg_marquardt";
  bundle::SolveOptions result = OptionsFromPython(damped);
  result.initial_trust_region_radius = kLargestRadius;
  return result;
}

py::list ChangeableOptions() {
  py::list names;
  bundle::VisitOptions(
      [&](bundle::Change change, const char* name, auto /*member*/, const auto&... /*choices*/) {
        if (change == bundle::Change::kBetweenSolves) names.append(name);
      });
  return names;
}

py::dict DefaultOptions() {
  py::dict result;
  bundle::VisitOptions(Writer{result});
  py::list refine;
  bundle::VisitRefine([&](const char* name, bool bundle::SolveOptions::* member) {
    if (bundle::SolveOptions().*member) refine.append(name);
  });
  result["refine"] = refine;
  return result;
}

py::dict OptionChoices() {
  py::dict result;
  bundle::VisitOptions(ChoiceLister{result});
  return result;
}
