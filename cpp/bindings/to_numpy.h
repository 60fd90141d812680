#pragma once

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

/// The vector as an array of the given shape, which takes ownership of its memory.
template <typename T, typename Allocator>
pybind11::array_t<T> ToNumpy(std::vector<T, Allocator> values,
                             std::vector<pybind11::ssize_t> shape) {
  using Vector = std::vector<T, Allocator>;
  auto* owned = new Vector(std::move(values));
  const pybind11::capsule owner(owned, [](void* vector) { delete static_cast<Vector*>(vector); });
  return pybind11::array_t<T>(std::move(shape), owned->data(), owner);
}
