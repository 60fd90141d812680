#pragma once

/// Exchange between Python and a running solve: iterations, Ctrl-C, exceptions.

#include <pybind11/pybind11.h>

#include <functional>
#include <optional>

#include "bindings/gil.h"
#include "core/interface/summary.h"
#include "core/parallel/thread_pool.h"

/// Reports each iteration to Python and checks for Ctrl-C. A KeyboardInterrupt stops the solve; a
/// signal or the callback may raise it. Any other exception of the callback or of a signal handler
/// also stops it and is stored. The first exception is raised at the end.
class PythonProgress {
 public:
  explicit PythonProgress(pybind11::object callback);

  /// True if the solve should continue. The callback gets the iteration even if Ctrl-C came first.
  bool operator()(const bundle::IterationRecord& record);

  /// True if the solve should stop within an iteration.
  bool IsInterrupted();

  /// Raises the stored exception. Requires the GIL.
  void Rethrow();

 private:
  void LookForSignals();
  void Guard(const std::function<void()>& function);

  pybind11::object callback_;
  bool sees_signals_ = false;  ///< Python handles signals on its main thread only
  bool stopped_ = false;
  std::optional<pybind11::error_already_set> kept_;
};

/// Runs solve() without the GIL. Throws the solver's exception, unless Python raised one before.
/// Throws KeyboardInterrupt if the interrupted solver has no result.
template <typename Function>
auto RunWatched(PythonProgress* progress, const Function& solve) {
  try {
    const ReleaseGil release;
    const bundle::InterruptionScope scope([progress] { return progress->IsInterrupted(); });
    return solve();
  } catch (const bundle::Interrupted&) {
    progress->Rethrow();
    PyErr_SetNone(PyExc_KeyboardInterrupt);
    throw pybind11::error_already_set();
  } catch (...) {
    progress->Rethrow();
    throw;
  }
}
