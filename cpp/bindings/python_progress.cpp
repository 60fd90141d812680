#include "bindings/python_progress.h"

#include <utility>

#include "bindings/gil.h"
#include "bindings/summary_to_python.h"

namespace py = pybind11;

PythonProgress::PythonProgress(py::object callback) : callback_(std::move(callback)) {
  const py::module_ threading = py::module_::import("threading");
  sees_signals_ = threading.attr("current_thread")().is(threading.attr("main_thread")());
}

bool PythonProgress::operator()(const bundle::IterationRecord& record) {
  const HoldGil held;
  if (!callback_.is_none()) {
    Guard([&] { CallPython(callback_, py::make_tuple(ToDict(record))); });
  }
  LookForSignals();
  return !stopped_;
}

bool PythonProgress::IsInterrupted() {
  if (!sees_signals_) return stopped_;  // without a need to wait for the GIL
  const HoldGil held;
  LookForSignals();
  return stopped_;
}

void PythonProgress::Rethrow() {
  if (kept_) throw py::error_already_set(*kept_);
}

void PythonProgress::LookForSignals() {
  Guard([] {
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  });
}

void PythonProgress::Guard(const std::function<void()>& function) {
  try {
    function();
  } catch (const py::error_already_set& error) {
    stopped_ = true;
    if (!kept_ && !error.matches(PyExc_KeyboardInterrupt)) kept_ = error;
  }
}
