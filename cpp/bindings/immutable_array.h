#pragma once

/// Arrays whose memory Python code cannot change.
///
/// The read-only flag of an array is not enough. The owner of the memory may be another, writable
/// array, a memory-mapped file, a buffer of another library, or an array whose flag can be set
/// back. An immutable array is read-only, and so is every array between it and the owner. The owner
/// is a `bytes` object or a capsule made here, which hides the memory from Python.

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

#include "bindings/to_numpy.h"

/// An immutable array on the memory of `array`. The caller must not access this memory otherwise.
pybind11::array Freeze(const pybind11::array& array);

bool IsImmutable(const pybind11::array& array);

/// Same as ToNumpy, for an immutable array.
template <typename T, typename Allocator>
pybind11::array ToImmutableNumpy(std::vector<T, Allocator> values,
                                 std::vector<pybind11::ssize_t> shape) {
  return Freeze(ToNumpy(std::move(values), std::move(shape)));
}
