#pragma once

/// The rotation nearest to a matrix M: that of the largest tr(R^T M).
///
/// It is the factor of the polar decomposition of M if det M > 0. In general, for a quaternion
/// q = (v, s), R = (s^2 - v^T v) I + 2 v v^T + 2 s [v]x, so tr(R^T M) = q^T K q with
///
///   K = [ M + M^T - tr(M) I   a     ]
///       [ a^T                 tr(M) ],      a = (M_21 - M_12, M_02 - M_20, M_10 - M_01)
///
/// (indices from 0), and q is an eigenvector of K's largest eigenvalue (Davenport's method). In the
/// plane, the angle is atan2(M_10 - M_01, M_00 + M_11).

namespace bundle {

/// Sets the rotation of a pose (x y angle or qx qy qz qw tx ty tz) to the one nearest to a matrix
/// of `dimension` squared numbers, row-major. The pose does not change if the nearest rotation is
/// not unique.
void SetNearestRotation(int dimension, const double* m, double* pose);

}  // namespace bundle
