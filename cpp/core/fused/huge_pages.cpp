#include "core/fused/huge_pages.h"

#if defined(__linux__)
#include <sys/mman.h>

#include <cstdint>
#endif

namespace bundle::fused {

void ReserveHugePages(size_t size, std::vector<double>* values) {
  if (size <= values->capacity()) return;
  values->reserve(size);
#if defined(__linux__)
  constexpr uintptr_t kHugePage = uintptr_t{1} << 21;
  const auto begin = reinterpret_cast<uintptr_t>(values->data());
  const uintptr_t first = (begin + kHugePage - 1) / kHugePage * kHugePage;
  const uintptr_t last = (begin + size * sizeof(double)) / kHugePage * kHugePage;
  // Refusal changes nothing but the time.
  if (last > first) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
#endif
}

}  // namespace bundle::fused
