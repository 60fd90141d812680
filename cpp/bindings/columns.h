#pragma once

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

#include "bindings/immutable_array.h"

namespace bundle {

/// The vector as an array, which takes ownership of its memory.
template <typename T>
pybind11::array Column(std::vector<T> values) {
  const auto count = static_cast<pybind11::ssize_t>(values.size());
  return ToImmutableNumpy(std::move(values), {count});
}

/// The same with rows of a width.
template <typename T>
pybind11::array Rows(std::vector<T> values, pybind11::ssize_t width) {
  const auto count = static_cast<pybind11::ssize_t>(values.size()) / width;
  return ToImmutableNumpy(std::move(values), {count, width});
}

}  // namespace bundle
