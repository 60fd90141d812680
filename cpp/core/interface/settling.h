#pragma once

/// Settling of the factors other than observations, in both backends.
///
/// The cost of thousands of observations can hide a few factors, such as the positions that alone
/// georeference a model. The remaining progress of these factors changes the total cost by less
/// than the function tolerance. Or the damping slows it down: damping that is small compared with
/// the information of the observations is large compared with that of the factors.
///
/// Therefore a solve with factors that meets the function or the parameter tolerance continues
/// once, nearly without damping. It ends with the first step that meets the function tolerance both
/// for the total cost and for the cost of each kind of factors (KindOf). This step is taken.
///
/// minimize/trust_region.cpp does this within a solve, ceres/settle_factors.h by a second solve.

namespace bundle {

/// Trust region radius of a step nearly without damping. Along undetermined directions, rounding
/// moves a state by 1e-16 times the radius.
inline constexpr double kWideRadius = 1e10;

/// Relative change of the cost that may be only rounding.
inline constexpr double kLostChange = 1e-12;

/// A solve whose function tolerance is at most this value does not continue. Its factors have
/// already settled, and undamped steps would only add rounding errors.
inline constexpr double kTightTolerance = 1e-9;

}  // namespace bundle
