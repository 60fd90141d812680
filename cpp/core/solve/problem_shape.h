#pragma once

#include <cstdint>

#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// The sizes that decide what a linear solver costs.
struct ProblemShape {
  int64_t num_residuals = 0;
  int64_t num_free_points = 0;
  int64_t num_camera_columns = 0;  ///< scalar unknowns on the camera side
  int num_camera_blocks = 0;
};

/// `num_residuals` is the number of residuals that reach the solver.
ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals);

/// Share of the block pairs of the reduced camera system S that are not zero (both triangles and
/// the diagonal), points eliminated. -1 where there are too many blocks to count it.
double CountSchurDensity(const ProblemView& problem, const ParameterLayout& layout);

}  // namespace bundle
