#include "core/ceres/ordering.h"

namespace bundle {

std::shared_ptr<ceres::ParameterBlockOrdering> MakeOrdering(EliminationOrdering ordering,
                                                            const ParameterLayout& layout,
                                                            int num_points, double* points,
                                                            double* state) {
  if (ordering == EliminationOrdering::kAutomatic) return nullptr;
  const bool points_first = ordering == EliminationOrdering::kPointsFirst;
  auto result = std::make_shared<ceres::ParameterBlockOrdering>();
  for (int p = 0; p < num_points; ++p) {
    if (layout.point_is_free(p)) {
      result->AddElementToGroup(points + 3 * static_cast<int64_t>(p), points_first ? 0 : 1);
    }
  }
  // Group 0 must be an independent set: an image's block and its shared camera's block stand in the
  // same residuals, so only one of them can be in it. Blocks of images come first in the layout.
  for (const CameraSideBlock& block : layout.blocks()) {
    const bool is_shared_camera = block.columns[0] >= kPoseSize && layout.has_shared_intrinsics();
    result->AddElementToGroup(state + block.offset, points_first || is_shared_camera ? 1 : 0);
  }
  return result;
}

bool NothingToEliminate(EliminationOrdering ordering, const ParameterLayout& layout) {
  const bool no_points = layout.num_free_points() == 0;
  const bool no_cameras = layout.blocks().empty();
  if (ordering == EliminationOrdering::kPointsFirst) return no_points && !no_cameras;
  if (ordering == EliminationOrdering::kCamerasFirst) return no_cameras && !no_points;
  return false;
}

}  // namespace bundle
