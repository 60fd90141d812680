#pragma once

/// Arrays whose memory nothing in Python can change.
///
/// The read-only flag of an array promises little: the owner of the memory may be another, writable
/// array, a memory-mapped file, a buffer of another library, or an array whose flag can be set
/// back. An immutable array is read-only, and so is every array between it and the owner; the owner
/// is a `bytes` object or a capsule of ours, which hides the memory from Python.

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

#include "bindings/to_numpy.h"

/// An immutable array on the memory of `array`, to which the caller gives up all other access.
pybind11::array Freeze(const pybind11::array& array);

bool IsImmutable(const pybind11::array& array);

/// ToNumpy for an immutable array.
template <typename T>
pybind11::array ToImmutableNumpy(std::vector<T> values, std::vector<pybind11::ssize_t> shape) {
  return Freeze(ToNumpy(std::move(values), std::move(shape)));
}
