#pragma once

#include <cstddef>
#include <vector>

namespace bundle::fused {

/// Makes room for `size` values and asks the system for large pages before they are touched: sums
/// into a large S go everywhere, and with pages of 4 kB nearly each of its columns is a miss of the
/// address translation as well. No more than a hint, and where it means nothing no more than a
/// reserve.
void ReserveHugePages(size_t size, std::vector<double>* values);

}  // namespace bundle::fused
