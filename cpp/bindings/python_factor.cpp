#include "bindings/python_factor.h"

#include <algorithm>
#include <string>
#include <utility>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "core/error.h"
#include "core/parallel/thread_pool.h"
#include "core/words.h"

namespace py = pybind11;

namespace {

/// None, or (residual, Jacobians or None).
py::object Call(const py::object& function, const std::vector<bundle::Retraction>& retractions,
                const double* const* values, bool jacobians) {
  py::list blocks;
  for (size_t b = 0; b < retractions.size(); ++b) {
    blocks.append(
        CastArray<double>(static_cast<py::ssize_t>(retractions[b].ambient_size()), values[b]));
  }
  return CallPython(function, py::make_tuple(blocks, jacobians));
}

int CountResiduals(const std::string& name, const py::object& function,
                   const std::vector<bundle::Retraction>& retractions,
                   const std::vector<const double*>& start) {
  const py::object answer = Call(function, retractions, start.data(), false);
  if (answer.is_none()) {
    throw bundle::InputError(name + ": expected a finite residual at the start, found no value");
  }
  return static_cast<int>(py::cast<CastArray<double>>(py::cast<py::tuple>(answer)[0]).size());
}

void Copy(const std::string& name, const CastArray<double>& from, py::ssize_t expected,
          double* to) {
  if (from.size() != expected) {
    throw bundle::InputError(name + ": expected " + bundle::Counted(expected, "number") +
                             ", found " + std::to_string(from.size()));
  }
  std::copy_n(from.data(), from.size(), to);
}

}  // namespace

PythonFactor::PythonFactor(bundle::FactorHead head, std::vector<bundle::Retraction> retractions,
                           py::object function, int num_dependent,
                           const std::vector<const double*>& start)
    : Factor(head, retractions, CountResiduals(head.name, function, retractions, start)),
      function_(std::move(function)),
      num_dependent_(num_dependent) {
  if (num_dependent > num_residuals()) {
    throw bundle::InputError(name() + ": num_dependent: expected at most " +
                             std::to_string(num_residuals()) + ", found " +
                             std::to_string(num_dependent));
  }
}

PythonFactor::~PythonFactor() {
  const HoldGil held;
  function_ = py::object();
}

bool PythonFactor::Evaluate(const double* const* values, double* residual,
                            double* const* jacobians) const {
  const HoldGil held;
  try {
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    const py::object answer = Call(function_, retractions(), values, jacobians != nullptr);
    if (answer.is_none()) return false;
    const auto pair = py::cast<py::tuple>(answer);
    Copy(name(), py::cast<CastArray<double>>(pair[0]), num_residuals(), residual);
    if (jacobians == nullptr) return true;
    const auto matrices = py::cast<py::sequence>(pair[1]);
    for (size_t b = 0; b < retractions().size(); ++b) {
      if (jacobians[b] == nullptr) continue;
      Copy(name(), py::cast<CastArray<double>>(matrices[b]),
           py::ssize_t{1} * num_residuals() * retractions()[b].tangent_size(), jacobians[b]);
    }
    return true;
  } catch (const py::error_already_set& error) {
    if (error.matches(PyExc_KeyboardInterrupt)) throw bundle::Interrupted();
    throw;
  }
}
