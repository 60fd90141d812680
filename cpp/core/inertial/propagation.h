#pragma once

/// States ahead of the last one that is known, from IMU samples alone.
///
/// A state is a row of 16 numbers: qx qy qz qw, px py pz, vx vy vz, bgx bgy bgz, bax bay baz
/// (ImuStateFromRow). With zero-order hold a sample moves it by
///
///   p += v dt + 1/2 (R f + g) dt^2,      v += (R f + g) dt,      R <- R Exp(w dt),
///
/// w and f the sample without its biases, which stay; by midpoint R f is the mean of both ends of
/// the interval and w~ likewise. These are the steps of preintegration.cpp in the world's frame.

#include "core/inertial/preintegration.h"

namespace bundle {

/// The state after each of `count` intervals, count x 16. Samples as in Preintegration::Integrate,
/// whose errors it throws.
void PropagateStates(const double state[16], const double gravity[3], IntegrationRule rule,
                     const double* gyro, const double* accel, const double* dt, int count,
                     double* out);

/// The state at the end of the motion, whose deltas are corrected to the biases of `state`.
void PredictState(const Preintegration& motion, const double state[16], const double gravity[3],
                  double out[16]);

}  // namespace bundle
