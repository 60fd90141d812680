#pragma once

/// FOV lenses near the jump of COLMAP's formula.
///
/// Let z = omega^2. The pixels of an FOV lens are smooth in z, and so is the cost of a solve. But
/// below z_0 = 1e-4 COLMAP has the series of the inverse lens (cameras/fov.h), which has the
/// opposite sign: there z has the effect of -z on the other side. A lens z' of the smooth family is
/// thus found
///
///   at z = z'   for z' >= z_0,      at z = -z'  for -z_0 < z' <= 0,
///
/// up to z^2, and for 0 < z' < z_0 and below -z_0 nowhere: the best pixels that a file can hold are
/// then those of a border or of z = 0, a pinhole. A descent cannot find that. It stops before the
/// jump, on either side, with a gradient towards it, or stays on a side without a minimum. Also,
/// near z = 0, derivatives by omega, which are 2 omega times those by z, vanish, and steps grow
/// without bound.
///
/// At z = 0 both sides meet, and derivatives by omega are 0: with omega = 0 a solve ends at the
/// best pinhole. There the slope along z of the inner side,
///
///   a = sum rho' r^T dr/dz / sigma^2,    dr/dz = (s / 3 - 1 / 12) (fx u, fy v),    s = u^2 + v^2,
///
/// determines the side that lowers the cost: the inner one with a < 0, else the outer one. A step
/// along z alone goes to |a| / sum rho' |dr/dz|^2 / sigma^2.

#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"

namespace bundle {

inline constexpr double kFovJump = 1e-2;  ///< |omega|

/// The cameras whose omega a solve may take over the jump: it is refined, has no bounds, and is a
/// number of its own or one that it equals.
std::vector<int> FindFreeFovLenses(const AdjustmentProblem& problem, const SolveOptions& options);

/// omega of a lens at the values of a problem.
double OmegaOf(const ProblemView& problem, int lens);

/// Sets omega of a lens in an array of parameters of the problem.
void SetOmega(const ProblemView& problem, int lens, double omega, std::vector<double>* params);

/// The omega to go on with of a lens that is a pinhole at the values of a problem, at its minimum
/// as such: on the side that lowers the cost, away from the jump.
double OmegaBesidePinhole(const AdjustmentProblem& problem, int lens, const SolveOptions& options);

}  // namespace bundle
