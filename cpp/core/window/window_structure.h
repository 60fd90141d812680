#pragma once

/// Structure of a window's reduced system: its nonzero blocks, their elimination order, and the
/// solver. It is dense for a window, whose states all share landmarks or a prior. For a long batch
/// it is supernodal, in AMD's or METIS' order.

#include <memory>
#include <vector>

#include "core/linear/linear_solver.h"
#include "core/window/window.h"

namespace bundle {

struct WindowStructure {
  std::vector<int> place;  ///< block of S for each block of the window; -1: constant
  BlockStructure structure;
  std::unique_ptr<LinearSolver> solver;
  double fill_ratio = 1;  ///< nonzeros of the factor relative to those of S's lower triangle
};

WindowStructure MakeWindowStructure(const WindowView& view);

}  // namespace bundle
