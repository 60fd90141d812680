#include "core/factors/reprojection_factor.h"

#include <algorithm>
#include <utility>

#include "core/cameras/registry.h"
#include "core/factors/checked_value.h"
#include "core/geometry/rotation.h"
#include "core/residuals/reprojection.h"

namespace bundle {
namespace {

PoseState StateOf(const double* pose) {
  PoseState state = {};
  QuaternionToRotation(pose, state.rotation);
  std::copy(pose + 4, pose + 7, state.translation);
  for (int i = 0; i < 3; ++i) state.left_jacobian[4 * i] = 1;
  return state;
}

}  // namespace

ReprojectionFactor::ReprojectionFactor(FactorHead head, const CameraModel& model,
                                       std::vector<double> observation,
                                       std::vector<double> information)
    : Factor(std::move(head),
             {Retraction(Manifold::kSe3, 7), Retraction(Manifold::kEuclidean, model.num_params),
              Retraction(Manifold::kEuclidean, 3)},
             2),
      model_(model),
      observation_(CheckedValue(name() + ": observation", Retraction(Manifold::kEuclidean, 2),
                                std::move(observation))),
      whitening_(name() + ": information", std::move(information), 2) {}

bool ReprojectionFactor::Evaluate(const double* const* values, double* residual,
                                  double* const* jacobians) const {
  const PoseState state = StateOf(values[0]);
  bool has_value = false;
  VisitCameraModel(model_, [&](auto model) {
    using Model = decltype(model);
    ReprojectionJacobian<kNumParams<Model>> jacobian;
    has_value = EvaluateReprojection<Model>(state, values[1], values[2], observation_.data(),
                                            Cheirality::kAlgebraic, residual,
                                            jacobians == nullptr ? nullptr : &jacobian);
    if (!has_value || jacobians == nullptr) return;
    if (jacobians[0] != nullptr) {
      for (int part = 0; part < 4; ++part) {  // of two rows: rotation, translation
        VectorMatrix3(jacobian.pose + 3 * part, state.rotation, jacobians[0] + 3 * part);
      }
    }
    if (jacobians[1] != nullptr) {
      std::copy(std::begin(jacobian.params), std::end(jacobian.params), jacobians[1]);
    }
    if (jacobians[2] != nullptr) {
      std::copy(std::begin(jacobian.point), std::end(jacobian.point), jacobians[2]);
    }
  });
  if (has_value) whitening_.Apply(residual, jacobians, {6, model_.num_params, 3});
  return has_value;
}

}  // namespace bundle
