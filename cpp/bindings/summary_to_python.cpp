#include "bindings/summary_to_python.h"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cmath>
#include <string>
#include <type_traits>
#include <vector>

#include "core/error.h"
#include "core/interface/options.h"

namespace py = pybind11;

namespace {

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

}  // namespace

py::dict ToDict(const bundle::SolveSummary& s) {
  py::dict d;
#define BUNDLE_FIELD(name) d[#name] = s.name
  BUNDLE_FIELD(initial_cost);
  BUNDLE_FIELD(final_cost);
  BUNDLE_FIELD(fixed_cost);
  BUNDLE_FIELD(held_cost);
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
  BUNDLE_FIELD(num_factors);
  BUNDLE_FIELD(backend_given);
  BUNDLE_FIELD(backend_used);
  BUNDLE_FIELD(backend_choice);
  BUNDLE_FIELD(instruction_set);
  BUNDLE_FIELD(linear_solver_choice);
  BUNDLE_FIELD(interrupted);
#undef BUNDLE_FIELD
  const auto known = [](double value) {
    return std::isnan(value) ? py::object(py::none()) : py::float_(value);
  };
  d["distance_in_sigmas"] = known(s.distance_in_sigmas);
  d["largest_camera_step_in_sigmas"] = known(s.largest_camera_step_in_sigmas);
  d["linear_solver_ordering_given"] = py::tuple(py::cast(s.linear_solver_ordering_given));
  d["linear_solver_ordering_used"] = py::tuple(py::cast(s.linear_solver_ordering_used));
  d["num_information_nonzeros"] = s.num_information_nonzeros < 0
                                      ? py::object(py::none())
                                      : py::int_(s.num_information_nonzeros);
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

py::dict ToDict(const bundle::IterationRecord& record) {
  py::dict d;
  VisitFields([&](const char* name, auto field) { d[name] = record.*field; });
  return d;
}

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

void PutRecord(const bundle::SolveRecord& record, py::dict* result) {
  py::dict& d = *result;
  d["summary"] = ToDict(record.summary);
  d["iterations"] = ToArrays(record.iterations);
  d["build_time_in_seconds"] = record.build_time_in_seconds;
  d["solve_time_in_seconds"] = record.solve_time_in_seconds;
}

std::vector<bundle::IterationRecord> RecordsFromPython(const py::dict& iterations) {
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
  return records;
}
