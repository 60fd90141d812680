#pragma once

/// Memory for the arrays of a solve, on large pages.
///
/// The system clears each page at its first touch: 1.3 us for 4 kB, but 26 us for 2 MB. On small
/// pages this took 0.5 of the 2.8 ms of a solve of 6,000 observations, and the heap returns its
/// pages after the solve. Arrays up to half a large page share a few large pages, which the process
/// keeps. Longer arrays come from the heap, with a hint.
///
/// A large page is a stack of arrays, empty again when the last one is freed. Its state is a single
/// number: it needs no lock, which a fork could leave locked. An array that outlives its solve
/// keeps one large page from other solves.

#include <cstddef>
#include <memory>
#include <vector>

namespace bundle {

/// Memory on a shared large page, aligned to a cache line, with any content; nullptr if the size is
/// below four pages or above half a large page, or if all large pages are in use.
void* AllocateInArena(size_t size) noexcept;

/// Frees the memory of AllocateInArena. Returns false if it is from elsewhere.
bool FreeInArena(void* memory, size_t size) noexcept;

bool IsInArena(const void* memory) noexcept;

/// Asks the operating system for large pages in memory that is not touched yet. Only a hint.
/// Without them, nearly each access to another column of a large matrix also misses the address
/// translation cache.
void AdviseHugePages(void* begin, size_t num_bytes) noexcept;

/// Memory from the arena or, with a hint, from the heap.
template <typename T>
struct ArenaAllocator {
  using value_type = T;

  ArenaAllocator() = default;
  template <typename U>
  ArenaAllocator(const ArenaAllocator<U>&) {}  // NOLINT(google-explicit-constructor)

  T* allocate(size_t count) {
    if (void* const memory = AllocateInArena(count * sizeof(T))) return static_cast<T*>(memory);
    T* const memory = std::allocator<T>().allocate(count);
    AdviseHugePages(memory, count * sizeof(T));
    return memory;
  }
  void deallocate(T* memory, size_t count) {
    if (!FreeInArena(memory, count * sizeof(T))) std::allocator<T>().deallocate(memory, count);
  }

  friend bool operator==(const ArenaAllocator&, const ArenaAllocator&) { return true; }
  friend bool operator!=(const ArenaAllocator&, const ArenaAllocator&) { return false; }
};

template <typename T>
using ArenaVector = std::vector<T, ArenaAllocator<T>>;

}  // namespace bundle
