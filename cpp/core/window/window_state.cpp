#include <algorithm>

#include "core/geometry/rotation.h"
#include "core/window/window.h"

namespace bundle {
namespace {

/// out = q Exp(d)
void Turn(const double* q, const double* d, double* out) {
  double step[4], turned[4];
  ExpQuaternion(d, step);
  QuaternionProduct(q, step, turned);
  NormalizeQuaternion(turned);
  std::copy_n(turned, 4, out);
}

/// Log(p^-1 q)
void TurnFrom(const double* p, const double* q, double* d) {
  const double inverse[4] = {-p[0], -p[1], -p[2], p[3]};
  double between[4];
  QuaternionProduct(inverse, q, between);
  LogQuaternion(between, d);
}

}  // namespace

void MoveState(const double* state, const double* d, double* out) {
  Turn(state, d, out);
  for (int k = 4; k < kStateNumbers; ++k) out[k] = state[k] + d[k - 1];
}

void StateFrom(const double* point, const double* state, double* d) {
  TurnFrom(point, state, d);
  for (int k = 4; k < kStateNumbers; ++k) d[k - 1] = state[k] - point[k];
}

void MoveCamera(const double* camera, const double* d, double* out) {
  Turn(camera, d, out);
  for (int k = 4; k < 7; ++k) out[k] = camera[k] + d[k - 1];
}

void CameraFromPoint(const double* point, const double* camera, double* d) {
  TurnFrom(point, camera, d);
  for (int k = 4; k < 7; ++k) d[k - 1] = camera[k] - point[k];
}

}  // namespace bundle
