#pragma once

/// The gauge: the choice of constraints that the options select, and the gauge directions.

#include <array>
#include <string>
#include <vector>

#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/camera_states.h"
#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Removes the unobservable degrees of freedom from `free`, one number for each; with three points
/// it removes two more numbers. Returns a message for the user if this could not be done as
/// requested; otherwise "".
std::string FixGauge(const AdjustmentProblem& problem, Gauge gauge, FreeParameters* free);

/// Translations, rotations and the scale of the world.
inline constexpr int kNumGaugeDirections = 7;

/// Derivatives of the chart (w, t) of a pose w.r.t. the gauge directions, with rotation and scaling
/// about a point: (w, t) x directions, row-major. Not for sensors.
void GaugeRowsOfPose(const PoseState& pose, const double centre[3],
                     double rows[kPoseSize * kNumGaugeDirections]);

/// Likewise of the coordinates of a point: 3 x directions, row-major.
void GaugeRowsOfPoint(const double point[3], const double centre[3],
                      double rows[3 * kNumGaugeDirections]);

/// Mean of the camera centres of all images.
std::array<double, 3> MeanCentre(const CameraStates& cameras, int num_images);

/// Derivatives of the camera parameters w.r.t. the similarities of the world about MeanCentre: for
/// each column of the layout, three translations, three rotations and the scale.
std::vector<double> GaugeDirections(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras);
/// Likewise about another centre.
std::vector<double> GaugeDirections(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras, const double centre[3]);

}  // namespace bundle
