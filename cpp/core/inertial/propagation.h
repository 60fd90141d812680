#pragma once

/// States after the last known state, predicted from IMU samples alone.
///
/// A state is a row of 16 numbers: qx qy qz qw, px py pz, vx vy vz, bgx bgy bgz, bax bay baz
/// (ImuStateFromRow). With zero-order hold a sample moves it by
///
///   p += v dt + 1/2 (R f + g) dt^2,      v += (R f + g) dt,      R <- R Exp(w dt),
///
/// where w and f are the sample without its biases, which are constant. By midpoint, R f and w~ are
/// means of both ends of the interval. These are the steps of preintegration.cpp in the world's
/// frame.

#include "core/inertial/preintegration.h"

namespace bundle {

/// The state after each of `count` intervals, count x 16. Samples and errors as in
/// Preintegration::Integrate.
void PropagateStates(const double state[16], const double gravity[3], IntegrationRule rule,
                     const double* gyro, const double* accel, const double* dt, int count,
                     double* out);

/// The state at the end of the motion. Its deltas are corrected to the biases of `state`.
void PredictState(const Preintegration& motion, const double state[16], const double gravity[3],
                  double out[16]);

}  // namespace bundle
