#pragma once

/// Exchange between Python and a running solve: iterations, Ctrl-C, exceptions.

#include <pybind11/pybind11.h>

#include <functional>
#include <optional>

#include "core/interface/summary.h"
#include "core/parallel/thread_pool.h"

/// Tells Python of each iteration and looks for Ctrl-C. KeyboardInterrupt stops the solve, whether
/// a signal raised it or the callback, in which a signal may have done so. Any other exception, of
/// the callback or of a signal handler, stops it too and is kept: the first comes out in the end.
class PythonProgress {
 public:
  explicit PythonProgress(pybind11::object callback);

  /// True if the solve is to go on. The callback sees the iteration even where Ctrl-C came first.
  bool operator()(const bundle::IterationRecord& record);

  /// True if the solve is to stop within an iteration.
  bool IsInterrupted();

  /// Raises what was kept. With the GIL.
  void Rethrow();

 private:
  void LookForSignals();
  void Guard(const std::function<void()>& function);

  pybind11::object callback_;
  bool sees_signals_ = false;  ///< as Python handles them on its main thread alone
  bool stopped_ = false;
  std::optional<pybind11::error_already_set> kept_;
};

/// Runs solve() without the GIL. Throws what the solver throws, unless Python raised something
/// before; KeyboardInterrupt where the solver was left with nothing to show for it.
template <typename Function>
auto RunWatched(PythonProgress* progress, const Function& solve) {
  try {
    const pybind11::gil_scoped_release release;
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
