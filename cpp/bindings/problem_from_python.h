#pragma once

#include <pybind11/pybind11.h>

#include "core/interface/adjustment_problem.h"

/// Views the arrays of a bundle.Problem, which must outlive the view. Throws InputError if a shape
/// is wrong; does not check values.
bundle::ProblemView ViewProblem(const pybind11::handle& problem);

/// Views the arrays of a Restrictions of Python, which must outlive the view; no restrictions for
/// None.
bundle::Restrictions ViewRestrictions(const pybind11::object& restrictions,
                                      const bundle::ProblemView& problem);
