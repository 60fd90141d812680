#pragma once

#include <pybind11/pybind11.h>

#include <string>

#include "core/interface/options.h"

/// Reads bundle.SolveOptions.asdict(), whose values Python has checked.
bundle::SolveOptions OptionsFromPython(const pybind11::dict& options);

/// Options of a factor graph: "gauss_newton" is Levenberg-Marquardt with negligible damping.
bundle::SolveOptions GraphOptionsFromPython(const pybind11::dict& options);

/// Reads the common options from a bundle.PoseGraphOptions as a dict.
void ReadPoseGraphOptions(const pybind11::dict& options, bundle::SolveOptions* result);

/// Reads the name of a loss.
bundle::LossType LossFromName(const std::string& name);

/// Reads the name of a cheirality.
bundle::Cheirality CheiralityFromName(const std::string& name);

/// Names of the options that may differ between the solves of a Solver.
pybind11::list ChangeableOptions();

/// The C++ defaults under Python's names, and the names of all choices, for the test that compares
/// the two definitions of the options.
pybind11::dict DefaultOptions();
pybind11::dict OptionChoices();
