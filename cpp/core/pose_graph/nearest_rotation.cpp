#include "core/pose_graph/nearest_rotation.h"

#include <algorithm>
#include <cmath>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

/// The orthogonal factor of M's polar decomposition by Newton's iteration X <- (g X + X^-T / g) /
/// 2, with g^3 = 1 / |det X| at first and 1 from then on (Higham, "Computing the polar
/// decomposition - with applications", 1986). Returns false if M has no positive determinant or the
/// iteration is slow: M is then close to a singular matrix.
bool FindPolarRotation(const double* m, double* rotation) {
  std::copy_n(m, 9, rotation);
  for (int iteration = 0; iteration < 8; ++iteration) {
    double cofactors[9];  // of X: det(X) X^-T
    for (int r = 0; r < 3; ++r) {
      Cross3(rotation + 3 * ((r + 1) % 3), rotation + 3 * ((r + 2) % 3), cofactors + 3 * r);
    }
    const double det =
        rotation[0] * cofactors[0] + rotation[1] * cofactors[1] + rotation[2] * cofactors[2];
    if (!(det > 0)) return false;
    const double g = iteration == 0 ? 1 / std::cbrt(det) : 1;
    double change = 0;
    for (int k = 0; k < 9; ++k) {
      const double next = 0.5 * (g * rotation[k] + cofactors[k] / (g * det));
      change = std::max(change, std::abs(next - rotation[k]));
      rotation[k] = next;
    }
    if (change < 1e-9) return true;  // quadratic: the error is the square of it
  }
  return false;
}

}  // namespace

void SetNearestRotation(int dimension, const double* m, double* pose) {
  if (dimension == 2) {
    const double sine = m[2] - m[1], cosine = m[0] + m[3];
    if (sine != 0 || cosine != 0) pose[2] = std::atan2(sine, cosine);
    return;
  }
  double rotation[9];
  if (FindPolarRotation(m, rotation)) {
    QuaternionFromRotation(rotation, pose);
    NormalizeQuaternion(pose);
    return;
  }
  Eigen::Matrix4d k;
  const double trace = m[0] + m[4] + m[8];
  const double a[3] = {m[7] - m[5], m[2] - m[6], m[3] - m[1]};
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) k(r, c) = m[3 * r + c] + m[3 * c + r] - (r == c ? trace : 0);
    k(r, 3) = k(3, r) = a[r];
  }
  k(3, 3) = trace;
  if (!(k.norm() > 0)) return;
  const Eigen::Vector4d q = LargestEigenvector(k);
  for (int i = 0; i < 4; ++i) pose[i] = q[i];
}

}  // namespace bundle
