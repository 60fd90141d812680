#pragma once

/// Gauge: the similarities of the world that a problem leaves free, and the S-transformation, which
/// makes a covariance independent of how they were held.
///
/// Let the columns of N be the derivatives of all free parameters by the similarities
/// (gauge_sums.h). A combination N q is free if no residual changes: J N q = 0. J N is summed up
/// row by row, before anything is eliminated. The singular values of its triangle are compared with
/// the parts of the rows, by cameras and by points, so that cancellation is recognised as zero up
/// to rounding. Fixed parts, rigs, priors and control points are so taken into account. Degrees of
/// freedom of several pieces of a world, or of points without parallax, are not counted here.
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
/// With the points eliminated (reduced_system.h), C = G_cc, and over the points
///
///   K = N_c - sum Y_p N_p,      A = sum N_p^T V_p^-1 N_p,
///
/// the parts of Y = G N are C K and V_p^-1 N_p - Y_p^T C K, and N^T Y = K^T C K + A. As H N = 0,
/// Y_p^T N_c = -N_p, and of any solution of H x = m, N^T x = K^T x_c + sum N_p^T V_p^-1 m_p. With
/// C' = (H^+)_cc, a point's block is (scatter_gauge.h, where M = H, P = V and E = 0)
///
///   (H^+)_pp = V_p^-1 + Y_p^T C' Y_p - N_p N_p^T V_p^-1 - V_p^-1 N_p N_p^T.
///
/// A point without parallax is anywhere on its ray, 1e7 scenes away perhaps, where a turn of the
/// world moves it by as much: with it in the trace, the world would be held by the directions of
/// such points alone. They are left out: with E the identity without their rows,
///
///   P = I - N (E N)^T,    (E N)^T N = I,
///
/// and all of the above holds for the other points with E N instead of N in sums: in N^T N, K, A
/// and, for the sandwich, in the contributions of points. This is the covariance with the least
/// trace over all but these points.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/gauge_sums.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class FreeGauge {
 public:
  /// Finds the free similarities. The system is not factorised yet. Makes a pass over the points if
  /// the system has no sums for the gauge.
  explicit FreeGauge(const ReducedSystem& system);

  /// Degrees of freedom d, at most seven.
  int degrees() const { return static_cast<int>(cameras_.cols()); }
  /// Adds B B^T to S: of a sparse S at as many entries of the diagonal; of a dense one, where that
  /// costs nothing, with B along N in units of the unknowns' sigmas, which rounds least.
  void Hold(ReducedSystem* system) const;
  /// B of a dense S, unknowns x d.
  Eigen::MatrixXd HeldDirections() const;
  /// N_c, the rows of the unknowns of N, which is orthonormal as a whole: unknowns x d.
  const Eigen::MatrixXd& cameras() const { return cameras_; }
  /// K, unknowns x d.
  const Eigen::MatrixXd& reduced() const { return reduced_; }
  /// A, d x d.
  const Eigen::MatrixXd& of_points() const { return of_points_; }
  const SimilarityMoves& moves() const { return moves_; }
  /// Combinations of the seven similarities that make N, 7 x kMoves, padded with zeros.
  const double* combinations() const { return padded_.data(); }
  /// N_p of a point, 3 x d; of one without parallax zero, (E N)_p.
  using PointRows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::ColMajor, 3, kSimilarities>;
  PointRows OfPoint(int point) const;
  /// P x, of each column.
  void Project(FullVectors* x) const;
  /// P^T x, of each column.
  void ProjectTransposed(FullVectors* x) const;

 private:
  const NullPoint* FindNullPoint(int point) const;  ///< nullptr: it has parallax
  /// N_p of a point, also along its undetermined directions: 3 x d.
  PointRows OfAnyPoint(int point) const;
  /// x - L R^T x, by the parts of L and R at points; those of cameras are N_c.
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
                     const BlockStructure& structure, std::vector<double>* values);

/// The S-transformation of blocks of G.
class InnerConstraints {
 public:
  /// `y` is C K. Keeps a reference to the gauge.
  InnerConstraints(const FreeGauge& gauge, Eigen::MatrixXd y);

  int degrees() const { return gauge_.degrees(); }
  /// Rows of N and Y: of unknowns [first, first + count), row-major (count x degrees).
  void RowsOfUnknowns(int first, int count, double* n, double* y) const;
  /// block (rows x columns, row-major) of G to that of H^+, by rows of N and Y, row-major.
  void Transform(int rows, const double* n_rows, const double* y_rows, int columns,
                 const double* n_columns, const double* y_columns, double* block) const;
  /// Turns all blocks of C into those of H^+.
  void TransformBlocks(const BlockStructure& structure, std::vector<double>* values) const {
    bundle::TransformBlocks(gauge_.cameras(), y_, k_, structure, values);
  }

 private:
  const FreeGauge& gauge_;
  const Eigen::MatrixXd y_;
  const Eigen::MatrixXd k_;  ///< N^T Y
};

}  // namespace bundle
