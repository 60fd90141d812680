#pragma once

/// The rows J and r of a window at a state, whitened and corrected for their losses.

#include <vector>

#include "core/window/inverse_depth.h"
#include "core/window/window.h"
#include "core/window/window_prior.h"

namespace bundle {

struct VisualRows {
  int landmark = 0, anchor = 0, observer = 0;
  double r[2];
  DepthJacobians by;
};

/// The anchoring image's own observation: two rows by (x, y) of the landmark, both `scale`.
struct AnchorRows {
  int landmark = 0;
  double r[2];
  double scale = 0;
};

/// Preintegrated samples (9 rows: rotation, position, velocity) and the biases' random walk (6).
struct InertialRows {
  static constexpr int kRows = 15, kImuRows = 9;  ///< rows of these factors
  int first = 0;                                  ///< from this state to the next one
  double r[kRows];
  double by_first[kRows * kStateTangent], by_second[kRows * kStateTangent];  ///< row-major
};

/// Selection of factors: all, or those absorbed by marginalising some states and landmarks.
struct FactorSelection {
  bool all = true;
  std::vector<uint8_t> landmarks;  ///< flags
  std::vector<uint8_t> imu;        ///< flags, n - 1
};

struct WindowRows {
  bool is_finite = true;
  WindowCosts costs;
  std::vector<VisualRows> visual;
  std::vector<AnchorRows> anchors;  ///< one per landmark in `visual`, in the same order
  std::vector<InertialRows> inertial;
  std::vector<PriorForm> priors;
};

/// Jacobians of states are taken at their anchors if the view says so.
void LinearizeWindow(const WindowView& view, const WindowState& at,
                     const FactorSelection& selection, WindowRows* rows);

/// Not finite if a landmark is behind a camera that sees it.
WindowCosts CostsOfWindow(const WindowView& view, const WindowState& at);

/// ||r|| of each observation without its loss; infinite if it has no value.
std::vector<double> VisualResidualNorms(const WindowView& view, const WindowState& at);

}  // namespace bundle
