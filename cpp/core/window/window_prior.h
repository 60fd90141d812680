#pragma once

/// Gradient and Hessian of a prior at a state of the window.
///
/// A prior is a quadratic form of d = (state about its points). With d' the coordinates about the
/// current state, d(d)/d(d') is I, except for rotations, where it is J_r^-1(d_rotation). Jacobians
/// of an anchored state are taken at its anchor, which is the prior's point: there, d = 0 and the
/// Jacobian is I.

#include <vector>

#include "core/window/window.h"

namespace bundle {

/// Gradient and second derivatives of the prior's blocks w.r.t. the coordinates about the state.
struct PriorForm {
  double cost = 0;
  std::vector<double> gradient;
  std::vector<double> information;  ///< row-major
};

PriorForm LinearizePrior(const WindowView& view, const WindowPrior& prior, const WindowState& at);
double CostOfPrior(const WindowView& view, const WindowPrior& prior, const WindowState& at);

/// The rows of a square-root prior by the coordinates about the state: M J, and M d + v.
void RowsOfPrior(const WindowView& view, const WindowPrior& prior, const WindowState& at,
                 std::vector<double>* jacobian, std::vector<double>* residual);

/// Coordinates of a block of `at` about `point`, a point of linearisation in the form that priors
/// store: PriorBlockSize numbers.
void BlockFromPoint(int block, int num_states, const double* point, const WindowState& at,
                    double* d);
/// Writes a block of `at` to `point` in the form that priors store: 16 numbers, unused ones zero.
void PointOfBlock(int block, int num_states, const WindowState& at, double* point);
/// True for blocks that begin with a rotation.
inline bool HasRotation(int block, int num_states) {
  return block == 2 * num_states || (block < 2 * num_states && block % 2 == 0);
}

}  // namespace bundle
