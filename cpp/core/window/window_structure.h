#pragma once

/// Structure of a window's reduced system: its nonzero blocks, their elimination order, and the
/// solver: dense for a window, whose states all share landmarks or a prior; for a long batch
/// supernodal, in AMD's or METIS' order.

#include <memory>
#include <vector>

#include "core/linear/linear_solver.h"
#include "core/window/window.h"

namespace bundle {

struct WindowStructure {
  std::vector<int> place;  ///< block of S of each block of the window; -1: held
  BlockStructure structure;
  std::unique_ptr<LinearSolver> solver;
  double fill_ratio = 1;  ///< nonzeros of the factor beside those of S's lower triangle
};

WindowStructure MakeWindowStructure(const WindowView& view);

}  // namespace bundle
