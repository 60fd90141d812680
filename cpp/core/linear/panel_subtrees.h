#pragma once

/// Division of the panels of a factor into subtrees, which threads factorise independently, and the
/// panels above them (derived in panel_subtrees.cpp).

#include <vector>

#include "core/linear/supernodes.h"

namespace bundle {

/// Panels [first, last): whole subtrees of the tree of panels.
struct PanelRange {
  int first, last;
};

struct PanelSubtrees {
  std::vector<PanelRange> subtrees;  ///< ascending
  std::vector<int> order;            ///< the subtrees, those with most flops first
  std::vector<int> top;              ///< all other panels, ascending
};

/// `parent`: per panel the panel of its first row below, -1 for a root; `width`: columns per panel.
PanelSubtrees FindSubtrees(const Supernodes& supernodes, const std::vector<int>& parent,
                           const std::vector<int>& width);

/// The same from `offset`: the first column of each block column, then the end.
PanelSubtrees FindSubtrees(const Supernodes& supernodes, const std::vector<int>& offset);

}  // namespace bundle
