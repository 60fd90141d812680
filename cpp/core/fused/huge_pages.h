#pragma once

#include <cstddef>
#include <vector>

namespace bundle::fused {

/// Asks the system for large pages where nothing has been touched yet. No more than a hint.
void AdviseHugePages(void* begin, size_t num_bytes);

/// Makes room for `size` values and asks the system for large pages before they are touched: sums
/// into a large S go everywhere, and with pages of 4 kB nearly each of its columns is a miss of the
/// address translation as well. Where large pages mean nothing, no more than a reserve.
template <typename T>
void ReserveHugePages(size_t size, std::vector<T>* values) {
  if (size <= values->capacity()) return;
  values->reserve(size);
  AdviseHugePages(values->data(), size * sizeof(T));
}

}  // namespace bundle::fused
