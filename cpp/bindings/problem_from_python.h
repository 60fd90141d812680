#pragma once

#include <pybind11/pybind11.h>

#include "core/interface/adjustment_problem.h"

/// Views the arrays of a bundle.Problem, which must outlive the view. Throws InputError if a shape
/// is wrong; does not check values.
bundle::ProblemView ViewProblem(const pybind11::handle& problem);

/// Views the arrays of a Python Restrictions object, which must outlive the view; None gives no
/// restrictions.
bundle::Restrictions ViewRestrictions(const pybind11::object& restrictions,
                                      const bundle::ProblemView& problem);
