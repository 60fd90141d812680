#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"

namespace bundle {

/// A Ceres manifold by name, for a block of `size` numbers; nullptr for "euclidean".
///
/// "quaternion_wxyz", "quaternion_xyzw" (4), "se3" (7: qx qy qz qw tx ty tz, as COLMAP stores a
/// pose), "sphere" (at least 2), "subset" with the entries that stay `constant`. Throws InputError
/// for any other name or a size that does not fit.
std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant);

}  // namespace bundle
