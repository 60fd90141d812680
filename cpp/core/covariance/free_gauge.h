#pragma once

/// Gauge: the similarities of the world that a problem leaves free, and the S-transformation, which
/// makes a covariance independent of the gauge constraints.
///
/// Let the columns of N be the derivatives of all free parameters with respect to the similarities
/// (gauge_sums.h). A combination N q is free if no residual changes: J N q = 0. J N is summed up
/// row by row, before the elimination. The singular values of its triangle are compared with the
/// two parts of the rows, by cameras and by points. So a cancellation up to rounding is recognised
/// as zero. This takes constant parameters, rigs, priors and control points into account. Degrees
/// of freedom of several components of a world, or of points without parallax, are not counted
/// here.
///
/// H is then singular. The inner constraints (E. M. Mikhail, F. Ackermann; B. Triggs et al.: Bundle
/// Adjustment - A Modern Synthesis, 2000, section 9) define the covariance of least trace, the
/// pseudo-inverse of H. Constrain d unknowns by a term B B^T in H, with B^T N regular. Then G = (H
/// + B B^T)^-1 is a generalised inverse, H G H = H. With N orthonormal,
///
///   H^+ = P G P,    P = I - N N^T        (W. Baarda's S-transformation),
///   (H^+)_ij = G_ij - N_i Y_j^T - Y_i N_j^T + N_i (N^T Y) N_j^T,    Y = G N,
///
/// which needs the same blocks of G as of H^+, and one solve with d right-hand sides. With the
/// points eliminated (reduced_system.h), C = G_cc. With the sums over the points
///
///   K = N_c - sum Y_p N_p,      A = sum N_p^T V_p^-1 N_p,
///
/// the parts of Y = G N are C K and V_p^-1 N_p - Y_p^T C K, and N^T Y = K^T C K + A. As H N = 0,
/// Y_p^T N_c = -N_p, and of any solution of H x = m, N^T x = K^T x_c + sum N_p^T V_p^-1 m_p. With
/// C' = (H^+)_cc, a point's block is (scatter_gauge.h, where M = H, P = V and E = 0)
///
///   (H^+)_pp = V_p^-1 + Y_p^T C' Y_p - N_p N_p^T V_p^-1 - V_p^-1 N_p N_p^T.
///
/// A point without parallax may be anywhere on its ray, perhaps 1e7 times the size of the scene
/// away. A rotation of the world moves it by as much. With such points in the trace, their
/// directions alone would determine the gauge. They are left out: with E the identity without their
/// rows,
///
///   P = I - N (E N)^T,    (E N)^T N = I,
///
/// and all of the above holds for the other points, with E N instead of N in sums: in N^T N, K, A
/// and, for the sandwich, in the contributions of points. This covariance has the least trace over
/// all parameters except these points.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/gauge_sums.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class FreeGauge {
 public:
  /// Finds the free similarities. The system must not be factorised yet. Makes a pass over the
  /// points if the system has no sums for the gauge.
  explicit FreeGauge(const ReducedSystem& system);

  /// Degrees of freedom d, at most seven.
  int degrees() const { return static_cast<int>(cameras_.cols()); }
  /// Adds B B^T to S. If S is sparse, B B^T has only d diagonal entries. If S is dense, fill-in has
  /// no cost. Then B is along N in units of the unknowns' sigmas, which gives the smallest rounding
  /// errors.
  void Hold(ReducedSystem* system) const;
  /// B of a dense S, unknowns x d.
  Eigen::MatrixXd HeldDirections() const;
  /// N_c, the rows of N for the unknowns, unknowns x d; all of N is orthonormal.
  const Eigen::MatrixXd& cameras() const { return cameras_; }
  /// K, unknowns x d.
  const Eigen::MatrixXd& reduced() const { return reduced_; }
  /// A, d x d.
  const Eigen::MatrixXd& of_points() const { return of_points_; }
  const SimilarityMoves& moves() const { return moves_; }
  /// Combinations of the seven similarities that form N, 7 x kMoves, padded with zeros.
  const double* combinations() const { return padded_.data(); }
  /// (E N)_p of a point, 3 x d; zero for a point without parallax.
  using PointRows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::ColMajor, 3, kSimilarities>;
  PointRows OfPoint(int point) const;
  /// N_p of a point, including its undetermined directions: 3 x d.
  PointRows OfAnyPoint(int point) const;
  /// P x, for each column.
  void Project(FullVectors* x) const;
  /// P^T x, for each column.
  void ProjectTransposed(FullVectors* x) const;

 private:
  const NullPoint* FindNullPoint(int point) const;  ///< nullptr: the point has parallax
  /// x - L R^T x. `L` and `R` give the rows of L and R for points; their rows for cameras are N_c.
  template <typename Left, typename Right>
  void Remove(const Left& left, const Right& right, FullVectors* x) const;
  void Take(const GaugeSums& sums);

  const ReducedSystem& system_;
  const SimilarityMoves moves_;
  Eigen::MatrixXd cameras_, reduced_, of_points_;
  Eigen::MatrixXd combinations_;  ///< combinations of the seven similarities, 7 x d
  Eigen::Matrix<double, kSimilarities, kMoves, Eigen::RowMajor> padded_;
};

/// Adds N_i (k N_j^T - Y_j^T) - Y_i N_j^T to all blocks (i, j).
void TransformBlocks(const Eigen::MatrixXd& n, const Eigen::MatrixXd& y, const Eigen::MatrixXd& k,
                     const BlockStructure& structure, BlockValues* values);

/// The S-transformation of blocks of G.
class InnerConstraints {
 public:
  /// `y` is C K. Keeps a reference to the gauge.
  InnerConstraints(const FreeGauge& gauge, Eigen::MatrixXd y);

  int degrees() const { return gauge_.degrees(); }
  /// Rows of N and Y for unknowns [first, first + count), row-major (count x degrees).
  void RowsOfUnknowns(int first, int count, double* n, double* y) const;
  /// Transforms a block (rows x columns, row-major) of G to that of H^+, using rows of N and Y,
  /// row-major.
  void Transform(int rows, const double* n_rows, const double* y_rows, int columns,
                 const double* n_columns, const double* y_columns, double* block) const;
  /// Transforms all blocks of C to those of H^+.
  void TransformBlocks(const BlockStructure& structure, BlockValues* values) const {
    bundle::TransformBlocks(gauge_.cameras(), y_, k_, structure, values);
  }

 private:
  const FreeGauge& gauge_;
  const Eigen::MatrixXd y_;
  const Eigen::MatrixXd k_;  ///< N^T Y
};

}  // namespace bundle
