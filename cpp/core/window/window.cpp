#include "core/window/window.h"

#include "core/geometry/retraction.h"

namespace bundle {
namespace {

const Retraction& Rotation() {
  static const Retraction rotation(Manifold::kSo3, 4);
  return rotation;
}

}  // namespace

void MoveState(const double* state, const double* d, double* out) {
  Rotation().Plus(state, d, out);
  for (int k = 4; k < kStateNumbers; ++k) out[k] = state[k] + d[k - 1];
}

void StateFrom(const double* point, const double* state, double* d) {
  Rotation().Local(point, state, d);
  for (int k = 4; k < kStateNumbers; ++k) d[k - 1] = state[k] - point[k];
}

void MoveCamera(const double* camera, const double* d, double* out) {
  Rotation().Plus(camera, d, out);
  for (int k = 4; k < 7; ++k) out[k] = camera[k] + d[k - 1];
}

void CameraFromPoint(const double* point, const double* camera, double* d) {
  Rotation().Local(point, camera, d);
  for (int k = 4; k < 7; ++k) d[k - 1] = camera[k] - point[k];
}

}  // namespace bundle
