#pragma once

/// Operations of a supernodal factorisation, by which its time is predicted.

#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

/// Sizes of a core's own cache and of the cache behind it, in bytes.
struct CacheSizes {
  double near, far;
};

/// Sums over the panels of a factor (linear/supernodes.h) and over the updates of one slice of a
/// panel's columns by another panel. A panel has w own columns and r rows below them. An update by
/// q of these rows computes a product of q columns and of the p rows from the first of them on.
///
/// An update reads p w values of its panel. They come from beyond a cache if the factorisation has
/// moved more values than the cache holds since their last use (panel_work.cpp).
struct PanelWork {
  double panels = 0;
  double updates = 0;
  double stored = 0;         ///< values of all panels
  double products = 0;       ///< sum of q p: values that updates add
  double reads = 0;          ///< sum of p w
  double near_misses = 0;    ///< reads from beyond the near cache
  double far_misses = 0;     ///< reads from beyond both caches
  double update_flops = 0;   ///< sum of 2 q p w
  double factor_flops = 0;   ///< sum of w^3 / 3 + w^2 r, of the panels' own columns
  double row_blocks = 0;     ///< block rows below the panels' own columns, once per update
  double busiest_share = 1;  ///< share of the factorisation that its busiest thread does
};

/// Counts the work for an order of elimination, which is a permutation of the blocks.
PanelWork CountPanelWork(const BlockPatternView& pattern, const std::vector<int>& order,
                         const CacheSizes& caches, int num_threads);

}  // namespace bundle
