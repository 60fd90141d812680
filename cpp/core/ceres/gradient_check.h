#pragma once

/// Two references for the Jacobians of one cost function at one point.
///
/// The first is ceres::GradientChecker, which users know. It differentiates along the tangent space
/// of the manifolds, so that errors along their normals hide, with a step of 1e-2 (of 1e-2 of the
/// parameter) that it shrinks at most a thousandfold, and compares an entry absolutely where one
/// side is exactly zero. Its numbers are kept, its verdict only counted.
///
/// The second reference (richardson.h) is taken in the ambient space, parameter by parameter, and
/// along the manifolds' Plus, without their PlusJacobian, and comes with a bound on its error.

#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/ceres/reference_checks.h"

namespace bundle {

/// Manifolds of a cost function's blocks, one each; nullptr: Euclidean.
using Manifolds = std::vector<const ceres::Manifold*>;

int AmbientSize(const ceres::CostFunction& cost);
int TangentSize(const ceres::CostFunction& cost, const Manifolds& manifolds);

/// What is known of a cost function beforehand.
struct KnownScales {
  /// Bounds of the first step of each ambient column, unless empty: the distance to a singularity.
  std::vector<double> largest_steps;
  /// Size of the numbers whose difference a residual is: it is rounded as they are.
  double minuend = 0;
};

ReferenceJacobians DifferentiateByRichardson(const ceres::CostFunction& cost,
                                             const Manifolds& manifolds,
                                             const std::vector<const double*>& parameters,
                                             const KnownScales& known = {});

GradientCheckerProbe RunGradientChecker(const ceres::CostFunction& cost, const Manifolds& manifolds,
                                        const std::vector<const double*>& parameters,
                                        double relative_precision);

}  // namespace bundle
