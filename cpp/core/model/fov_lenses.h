#pragma once

/// FOV lenses near the discontinuity of COLMAP's formula.
///
/// Let z = omega^2. The pixels of an FOV lens are smooth in z, and so is the cost of a solve. But
/// below z_0 = 1e-4, COLMAP uses the series of the inverse lens (cameras/fov.h), which has the
/// opposite sign: there, z has the effect of -z above z_0. A lens z' of the smooth family is thus
/// represented
///
///   at z = z'   for z' >= z_0,      at z = -z'  for -z_0 < z' <= 0,
///
/// up to z^2. For 0 < z' < z_0 and for z' below -z_0, no z represents it. The best pixels that a
/// file can hold are then those at a border or at z = 0, a pinhole. A descent cannot find them. It
/// stops before the discontinuity, on either side, with a gradient towards it, or stays on a side
/// without a minimum. Also, near z = 0, derivatives w.r.t. omega, which are 2 omega times those
/// w.r.t. z, vanish, and steps grow without bound.
///
/// At z = 0 both sides meet, and derivatives w.r.t. omega are 0: a solve that starts with omega = 0
/// ends at the best pinhole. There, the slope along z of the inner side,
///
///   a = sum rho' r^T dr/dz / sigma^2,    dr/dz = (s / 3 - 1 / 12) (fx u, fy v),    s = u^2 + v^2,
///
/// determines the side that lowers the cost: the inner side if a < 0, otherwise the outer side. A
/// step along z alone goes to |a| / sum rho' |dr/dz|^2 / sigma^2.

#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"

namespace bundle {

inline constexpr double kFovJump = 1e-2;  ///< |omega|

/// The cameras whose omega a solve may move across the discontinuity: omega is refined, has no
/// bounds, and is not tied to other numbers except by equality.
std::vector<int> FindFreeFovLenses(const AdjustmentProblem& problem, const SolveOptions& options);

/// omega of a lens at the values of a problem.
double OmegaOf(const ProblemView& problem, int lens);

/// Sets omega of a lens in an array of the problem's parameters.
void SetOmega(const ProblemView& problem, int lens, double omega, std::vector<double>* params);

/// For a lens whose omega is 0 at a minimum: returns the omega from which the solve continues. It
/// is on the side that lowers the cost, away from the discontinuity.
double OmegaBesidePinhole(const AdjustmentProblem& problem, int lens, const SolveOptions& options);

}  // namespace bundle
