#pragma once

/// Marginalises states and landmarks of a window into a prior on the remaining variables.
///
/// The absorbed factors have the rows J d + r about the current state; Jacobians of anchored states
/// are taken at the anchors. With a the eliminated and b the kept coordinates,
///
///   information   Lambda = H_bb - H_ba H_aa^-1 H_ab,      eta = -(g_b - H_ba H_aa^-1 g_a)
///   square root   Q^T [J_a J_b r] = [R_a R_ab r_a; 0 M v; 0 0 rest]
///
/// where landmarks, with three coordinates each that are independent of other landmarks, are
/// eliminated first: by a Cholesky factor of their own block, or by Householder reflections of
/// their own rows. M^T M = Lambda. The square root halves the number of digits needed. Small
/// eigenvalues of Lambda lose their sign beyond 1e7 (1e16) times below the largest in single
/// (double) precision; squares of M's singular values do not (N. Demmel, C. Sommer, D. Cremers, V.
/// Usenko, Square root bundle adjustment, CVPR 2021, and its windows: ICCV 2021).
///
/// The prior is then written about its points. For blocks of an absorbed prior, this is the point
/// of that prior if `keep_points`; for all others it is the current state. With d0 the current
/// state about the points and T = d(state)/d(d), which is J_r(d0) for rotations without anchor,
///
///   Lambda <- T^T Lambda T,   eta <- T^T eta + Lambda d0,   M <- M T,   v <- v - M d0.
///
/// Its constant is the cost of the absorbed factors and of all earlier priors. A window that
/// compares its steps with its cost leaves out the minimum of the prior, which no step changes.
/// Otherwise, constants would accumulate in a running window, and steps would seem smaller and
/// smaller.

#include <cstdint>
#include <vector>

#include "core/window/window.h"

namespace bundle {

struct Marginalization {
  std::vector<uint8_t> states;     ///< flags: eliminated states
  std::vector<uint8_t> landmarks;  ///< flags: landmarks eliminated with all their observations
  std::vector<uint8_t> imu;        ///< flags: absorbed IMU factors
  bool keep_points = true;
  bool square_root = false;
  bool single_precision = false;
};

struct MarginalizedWindow {
  WindowPrior prior;
  /// Largest |Lambda - Lambda^T| relative to the largest |Lambda|, before it is made symmetric.
  double asymmetry = 0;
  double least_cost = 0;  ///< cost of the prior at its own minimum
  int num_landmarks = 0;  ///< number of marginalised landmarks
  int num_landmarks_without_depth =
      0;                   ///< landmarks removed without their depth, because no row depends on it
  bool is_regular = true;  ///< false if H_aa is singular and was inverted on a subspace
};

/// Absorbs all priors of the view. Throws InputError if a kept landmark is anchored in an
/// eliminated state, or seen in one.
MarginalizedWindow MarginalizeWindow(const WindowView& view, const Marginalization& request);

/// Eigenvalues of a prior's Lambda, ascending.
std::vector<double> SpectrumOfPrior(const WindowPrior& prior);
/// Same with Lambda's diagonal scaled to 1, which makes them independent of units.
std::vector<double> ScaledSpectrumOfPrior(const WindowPrior& prior);

}  // namespace bundle
