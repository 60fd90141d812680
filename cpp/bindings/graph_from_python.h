#pragma once

#include <pybind11/pybind11.h>

#include "core/graph/factor_graph.h"

/// Reads the output of python/bundle/graphs/factors/factor_graph.py:
///
/// - a variable: (name, manifold, value, held, lower, upper), of which the last three may be empty;
/// - a factor: (kind, name, indices of its variables, loss, scale, arguments of the kind).
///
/// Throws InputError if a factor refuses its arguments. Requires the GIL, also when the graph is
/// destroyed.
bundle::Block VariableFromPython(const pybind11::tuple& variable);
bundle::FactorGraph GraphFromPython(const pybind11::list& variables, const pybind11::list& factors);
