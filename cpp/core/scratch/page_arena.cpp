#include "core/scratch/page_arena.h"

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include <atomic>
#include <cstdint>

namespace bundle {
namespace {

constexpr size_t kLargePage = size_t{1} << 21;
constexpr size_t kNumLargePages = 4;
constexpr size_t kLeast = size_t{1} << 14;  // the heap reuses the few pages of smaller arrays
constexpr size_t kMost = kLargePage / 2;
constexpr size_t kCacheLine = 64;

/// Arrays of a large page, one behind the other from its begin on.
struct alignas(sizeof(uint64_t)) Stack {  // as aligned as one number, for atomic access
  uint32_t bytes;
  uint32_t num_arrays;
};
std::atomic<Stack> stacks[kNumLargePages];

uintptr_t RoundUp(uintptr_t number, size_t unit) { return (number + unit - 1) / unit * unit; }

/// Address space of the large pages. nullptr if the system refuses it.
char* Reserve() noexcept {
#if defined(__linux__) && !defined(__SANITIZE_ADDRESS__)  // which checks the bounds of each array
  void* const memory = mmap(nullptr, (kNumLargePages + 1) * kLargePage, PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED) return nullptr;
  const auto address = reinterpret_cast<uintptr_t>(memory);
  char* const begin = static_cast<char*>(memory) + (RoundUp(address, kLargePage) - address);
  AdviseHugePages(begin, kNumLargePages * kLargePage);
  return begin;
#else
  return nullptr;
#endif
}

char* Begin() noexcept {
  static char* const begin = Reserve();
  return begin;
}

}  // namespace

void* AllocateInArena(size_t size) noexcept {
  if (size < kLeast || size > kMost || Begin() == nullptr) return nullptr;
  const auto rounded = static_cast<uint32_t>(RoundUp(size, kCacheLine));
  for (size_t page = 0; page < kNumLargePages; ++page) {
    Stack seen = stacks[page].load(std::memory_order_relaxed);
    while (seen.bytes + rounded <= kLargePage) {
      const Stack next{seen.bytes + rounded, seen.num_arrays + 1};
      if (stacks[page].compare_exchange_weak(seen, next, std::memory_order_acquire)) {
        return Begin() + page * kLargePage + seen.bytes;
      }
    }
  }
  return nullptr;
}

bool FreeInArena(void* memory, size_t size) noexcept {
  if (size < kLeast || size > kMost || !IsInArena(memory)) return false;
  const size_t offset = static_cast<size_t>(static_cast<char*>(memory) - Begin());
  std::atomic<Stack>& stack = stacks[offset / kLargePage];
  const auto first = static_cast<uint32_t>(offset % kLargePage);
  Stack seen = stack.load(std::memory_order_relaxed), next;
  do {
    const bool is_last = first + RoundUp(size, kCacheLine) == seen.bytes;
    next = {is_last ? first : seen.bytes, seen.num_arrays - 1};
    if (next.num_arrays == 0) next.bytes = 0;
  } while (!stack.compare_exchange_weak(seen, next, std::memory_order_release));
  return true;
}

bool IsInArena(const void* memory) noexcept {
  const auto address = reinterpret_cast<uintptr_t>(memory);
  const auto begin = reinterpret_cast<uintptr_t>(Begin());
  return begin != 0 && address >= begin && address < begin + kNumLargePages * kLargePage;
}

void AdviseHugePages(void* begin, size_t num_bytes) noexcept {
#if defined(__linux__)
  const auto address = reinterpret_cast<uintptr_t>(begin);
  const uintptr_t first = RoundUp(address, kLargePage);
  const uintptr_t last = (address + num_bytes) / kLargePage * kLargePage;
  // If the system refuses, only the time changes.
  if (last > first) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
#else
  static_cast<void>(begin), static_cast<void>(num_bytes);
#endif
}

}  // namespace bundle
