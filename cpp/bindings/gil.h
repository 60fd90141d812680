#pragma once

/// The global interpreter lock (GIL), released or held for a scope, and calls of Python functions.
///
/// At exit, Python before 3.14 ends a daemon thread that asks for the lock, or runs Python code, by
/// pthread_exit. That unwinds the stack, and C++ calls std::terminate at a destructor or a handler
/// on the way: the process would abort after its work was done. Here such a thread waits until the
/// process has ended, as in Python 3.14.

#include <cxxabi.h>
#include <pybind11/pybind11.h>
#include <unistd.h>

#include <optional>

/// Calls a function of Python's C interface that may end this thread; then waits instead. The
/// function must own no objects of Python: their destructors would run without the lock.
template <typename Function>
void StayAtExit(const Function& call) {
#ifdef __GLIBCXX__
  try {
    call();
  } catch (const abi::__forced_unwind&) {
    for (;;) pause();
  }
#else
  call();
#endif
}

/// Releases the lock; other threads may run Python code.
class ReleaseGil {
 public:
  ReleaseGil() = default;
  ~ReleaseGil() {
    StayAtExit([this] { PyEval_RestoreThread(state_); });
  }
  ReleaseGil(const ReleaseGil&) = delete;
  ReleaseGil& operator=(const ReleaseGil&) = delete;

 private:
  PyThreadState* const state_ = PyEval_SaveThread();
};

/// Holds the lock; this thread may run Python code.
class HoldGil {
 public:
  HoldGil() {
    StayAtExit([this] { acquired_.emplace(); });
  }
  HoldGil(const HoldGil&) = delete;
  HoldGil& operator=(const HoldGil&) = delete;

 private:
  std::optional<pybind11::gil_scoped_acquire> acquired_;
};

/// Calls a Python function with the lock held. Throws the exception of the function.
inline pybind11::object CallPython(const pybind11::object& function,
                                   const pybind11::tuple& arguments) {
  PyObject* result = nullptr;
  StayAtExit([&] { result = PyObject_CallObject(function.ptr(), arguments.ptr()); });
  if (result == nullptr) throw pybind11::error_already_set();
  return pybind11::reinterpret_steal<pybind11::object>(result);
}
