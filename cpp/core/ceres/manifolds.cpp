#include "core/ceres/manifolds.h"

#include <set>

#include "core/error.h"

namespace bundle {
namespace {

void ExpectSize(const std::string& name, int found, int expected) {
  if (found == expected) return;
  throw InputError("manifolds: " + name + " expects a block of " + std::to_string(expected) +
                   " numbers, found " + std::to_string(found));
}

void CheckSubset(int size, const std::vector<int>& constant) {
  const std::set<int> distinct(constant.begin(), constant.end());
  if (distinct.size() != constant.size()) {
    throw InputError("manifolds: subset names an entry twice");
  }
  if (static_cast<int>(distinct.size()) >= size) {
    throw InputError("manifolds: subset leaves nothing of " + std::to_string(size) + " numbers");
  }
  if (distinct.empty() || *distinct.begin() < 0 || *distinct.rbegin() >= size) {
    throw InputError("manifolds: subset expects entries from 0 to " + std::to_string(size - 1));
  }
}

}  // namespace

std::unique_ptr<ceres::Manifold> MakeManifold(const std::string& name, int size,
                                              const std::vector<int>& constant) {
  if (name == "euclidean") return nullptr;
  if (name == "quaternion_wxyz") {
    ExpectSize(name, size, 4);
    return std::make_unique<ceres::QuaternionManifold>();
  }
  if (name == "quaternion_xyzw") {
    ExpectSize(name, size, 4);
    return std::make_unique<ceres::EigenQuaternionManifold>();
  }
  if (name == "se3") {
    ExpectSize(name, size, 7);
    return std::make_unique<
        ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>>();
  }
  if (name == "sphere") {
    if (size < 2) throw InputError("manifolds: sphere expects a block of at least 2 numbers");
    return std::make_unique<ceres::SphereManifold<ceres::DYNAMIC>>(size);
  }
  if (name == "subset") {
    CheckSubset(size, constant);
    return std::make_unique<ceres::SubsetManifold>(size, constant);
  }
  throw InputError(
      "manifolds: expected euclidean, angle_axis, quaternion_wxyz, quaternion_xyzw, "
      "se3, sphere or subset, found '" +
      name + "'");
}

}  // namespace bundle
