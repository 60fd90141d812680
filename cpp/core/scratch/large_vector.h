#pragma once

/// Vectors that grow with the observations or points of a problem.

#include <cstddef>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/scratch/page_arena.h"
#include "core/scratch/scratch_files.h"

namespace bundle {

/// Memory from the scratch folder, if one is open, or else from the arena or the heap.
///
/// Numbers without a value are not initialised: `resize(n)` does not write to new elements, and
/// `resize(n, 0)` does. Zeros that are overwritten would be written to the disk for nothing.
template <typename T>
struct LargeAllocator {
  using value_type = T;

  LargeAllocator() = default;
  template <typename U>
  LargeAllocator(const LargeAllocator<U>&) {}  // NOLINT(google-explicit-constructor)

  T* allocate(size_t count) {
    if (void* const memory = AllocateScratch(count * sizeof(T))) return static_cast<T*>(memory);
    return ArenaAllocator<T>().allocate(count);
  }
  void deallocate(T* memory, size_t count) {
    if (!FreeScratch(memory, count * sizeof(T))) ArenaAllocator<T>().deallocate(memory, count);
  }

  template <typename U>
  void construct(U* at) {
    if constexpr (!std::is_trivially_default_constructible_v<U>) ::new (static_cast<void*>(at)) U();
  }
  template <typename U, typename... Values>
  void construct(U* at, Values&&... values) {
    ::new (static_cast<void*>(at)) U(std::forward<Values>(values)...);
  }

  friend bool operator==(const LargeAllocator&, const LargeAllocator&) { return true; }
  friend bool operator!=(const LargeAllocator&, const LargeAllocator&) { return false; }
};

template <typename T>
using LargeVector = std::vector<T, LargeAllocator<T>>;

}  // namespace bundle
