#include "core/fused/huge_pages.h"

#if defined(__linux__)
#include <sys/mman.h>

#include <cstdint>
#endif

namespace bundle::fused {

#if defined(__linux__)
void AdviseHugePages(void* begin, size_t num_bytes) {
  constexpr uintptr_t kHugePage = uintptr_t{1} << 21;
  const auto address = reinterpret_cast<uintptr_t>(begin);
  const uintptr_t first = (address + kHugePage - 1) / kHugePage * kHugePage;
  const uintptr_t last = (address + num_bytes) / kHugePage * kHugePage;
  // Refusal changes nothing but the time.
  if (last > first) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
}
#else
void AdviseHugePages(void*, size_t) {}
#endif

}  // namespace bundle::fused
