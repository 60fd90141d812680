#pragma once

#include <pybind11/numpy.h>

#include <utility>
#include <vector>

#include "core/scratch/page_arena.h"

/// The vector as an array of the given shape, which takes ownership of its memory. Copies memory of
/// the arena, which is for the time of a solve.
template <typename T, typename Allocator>
pybind11::array_t<T> ToNumpy(std::vector<T, Allocator> values,
                             std::vector<pybind11::ssize_t> shape) {
  using Vector = std::vector<T, Allocator>;
  if (bundle::IsInArena(values.data())) {
    return ToNumpy(std::vector<T>(values.begin(), values.end()), std::move(shape));
  }
  auto* owned = new Vector(std::move(values));
  const pybind11::capsule owner(owned, [](void* vector) { delete static_cast<Vector*>(vector); });
  return pybind11::array_t<T>(std::move(shape), owned->data(), owner);
}
