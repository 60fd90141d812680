#include "core/solve/problem_shape.h"

#include <vector>

#include "core/solve/coupled_blocks.h"

namespace bundle {
namespace {

/// Beyond this many blocks a count takes longer than what it decides is worth.
constexpr int kMaxBlocksToCount = 20000;

}  // namespace

double CountSchurDensity(const ProblemView& problem, const ParameterLayout& layout) {
  const auto n = static_cast<int64_t>(layout.blocks().size());
  if (n == 0 || n > kMaxBlocksToCount) return -1;
  int64_t lower = 0;
  for (const std::vector<int>& column : FindCoupledBlocks(problem, layout)) {
    lower += static_cast<int64_t>(column.size());
  }
  return static_cast<double>(2 * lower - n) / (static_cast<double>(n) * static_cast<double>(n));
}

ProblemShape ShapeOf(const ParameterLayout& layout, int64_t num_residuals) {
  ProblemShape shape;
  shape.num_residuals = num_residuals;
  shape.num_free_points = layout.num_free_points();
  shape.num_camera_columns = layout.state_size();
  shape.num_camera_blocks = static_cast<int>(layout.blocks().size());
  return shape;
}

}  // namespace bundle
