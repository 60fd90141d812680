#pragma once

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

/// The vector as an array of the given shape, which takes ownership of its memory.
template <typename T>
pybind11::array_t<T> ToNumpy(std::vector<T> values, std::vector<pybind11::ssize_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  const pybind11::capsule owner(owned,
                                [](void* vector) { delete static_cast<std::vector<T>*>(vector); });
  return pybind11::array_t<T>(std::move(shape), owned->data(), owner);
}
