#pragma once

/// Arguments that are arrays in C order: Array<T> converts without loss, or refuses; CastArray<T>
/// converts any numbers.

#include <pybind11/numpy.h>

template <typename T>
using Array = pybind11::array_t<T, pybind11::array::c_style>;
template <typename T>
using CastArray = pybind11::array_t<T, pybind11::array::c_style | pybind11::array::forcecast>;
