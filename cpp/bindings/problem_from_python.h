#pragma once

#include <pybind11/pybind11.h>

#include "core/problem/problem_view.h"

/// Views the arrays of a bundle.Problem, which must outlive the view. Throws InputError if a shape
/// is wrong; values are not looked at.
bundle::ProblemView ViewProblem(const pybind11::handle& problem);

/// Adds the arrays of a bundle.restrictions.Restrictions, which must outlive the view, unless it is
/// None.
void PutRestrictions(const pybind11::object& restrictions, bundle::ProblemView* view);
