#pragma once

/// A problem of Python's with its restrictions and factors, and one computation on it.

#include <pybind11/pybind11.h>

#include "bindings/given_factors.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/python_progress.h"

class GivenProblem {
 public:
  GivenProblem(const pybind11::object& problem, const pybind11::dict& options,
               const pybind11::object& restrictions, const pybind11::object& factors)
      : view_(ViewProblem(problem)), options_(OptionsFromPython(options)), factors_(factors) {
    view_.restrictions = ViewRestrictions(restrictions, view_);
  }

  const bundle::AdjustmentProblem& view() const { return view_; }

  /// compute(view, options) of the valid problem, without the GIL; Ctrl-C stops it. Call once.
  template <typename Compute>
  auto Run(const Compute& compute) {
    PythonProgress watch{pybind11::none()};
    auto output = RunWatched(&watch, [&] {
      bundle::ValidateProblem(view_);
      view_.factors = factors_.Check();
      return compute(view_, options_);
    });
    watch.Rethrow();
    return output;
  }

 private:
  bundle::AdjustmentProblem view_;
  bundle::SolveOptions options_;
  GivenFactors factors_;
};
