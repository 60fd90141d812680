#pragma once

/// What a problem leaves free of the seven similarities of the world, and the S-transformation that
/// makes a covariance independent of how this was held.
///
/// Let N hold, column by column, what the similarities do to all that is free (unknowns of the
/// layout and points), about the centre of the scene. A combination N q is free if no residual
/// changes: J N q = 0. J N is summed up row by row, before anything is eliminated, as the triangle
/// of its QR factorisation; singular values are compared with the parts of the rows, by cameras and
/// by points, so that what cancels is zero to rounding. That counts fixed parts, rigs, priors and
/// control points without looking for them. What several pieces of a world, or points without
/// parallax, leave beyond that is not counted here.
///
/// H is then singular. The inner constraints (E. M. Mikhail, F. Ackermann; B. Triggs et al.: Bundle
/// Adjustment - A Modern Synthesis, 2000, section 9) ask for its pseudo-inverse, the covariance of
/// least trace. Let d unknowns be held, by a term B B^T in H, with B^T N regular. Then G = (H + B
/// B^T)^-1 is a generalised inverse, H G H = H, and with N orthonormal,
///
///   H^+ = P G P,    P = I - N N^T        (W. Baarda's S-transformation),
///   (H^+)_ij = G_ij - N_i Y_j^T - Y_i N_j^T + N_i (N^T Y) N_j^T,    Y = G N,
///
/// which needs blocks of G where blocks of H^+ are wanted, and one solve with d right-hand sides.

#include <vector>

#include "core/covariance/reduced_system.h"

namespace bundle {

class FreeGauge {
 public:
  /// Looks for what is free. The system is not factorised yet.
  explicit FreeGauge(const ReducedSystem& system);

  /// Degrees of freedom, at most seven.
  int degrees() const { return n_.num_columns; }
  /// Adds B B^T to S: of a sparse S at as many entries of the diagonal; of a dense one, where that
  /// costs nothing, with B along N in units of the unknowns' sigmas, which rounds least.
  void Hold(ReducedSystem* system) const;
  /// N, orthonormal.
  const FullVectors& directions() const { return n_; }

 private:
  FullVectors n_;
};

/// The S-transformation of blocks of a covariance.
class InnerConstraints {
 public:
  /// `directions` is N, `y` the covariance times N. Keeps references to both.
  InnerConstraints(const FullVectors& directions, const FullVectors& y);

  int degrees() const { return n_.num_columns; }
  /// Rows of N and Y: of unknowns [first, first + count), or of a point, row-major (count x
  /// degrees).
  void RowsOfUnknowns(int first, int count, double* n, double* y) const;
  void RowsOfPoint(int point, double* n, double* y) const;
  /// block (rows x columns, row-major) of G to that of H^+, by rows of N and Y, row-major.
  void Transform(int rows, const double* n_rows, const double* y_rows, int columns,
                 const double* n_columns, const double* y_columns, double* block) const;

 private:
  const FullVectors& n_;
  const FullVectors& y_;
  std::vector<double> k_;  ///< N^T Y
};

}  // namespace bundle
