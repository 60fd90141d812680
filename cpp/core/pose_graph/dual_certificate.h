#pragma once

/// Dual certificate of a point of a chordal cost: bound on the optimum, spectrum of S (derived in
/// dual_certificate.cpp).

#include <Eigen/Core>
#include <vector>

#include "core/pose_graph/certificate.h"
#include "core/pose_graph/chordal_cost.h"
#include "core/pose_graph/edge_matrix.h"

namespace bundle {

struct DualSpectrum {
  /// Smallest eigenvalues of S outside of the rows of X, ascending, each with its multiplicity.
  std::vector<double> eigenvalues;
  double of_rows = 0;         ///< smallest Rayleigh quotient of a row of X, 0 at a critical point
  Eigen::VectorXd direction;  ///< eigenvector of the smallest eigenvalue, (d + 1) n, of norm 1 in Y
};

/// S = Q - Lambda at a point.
class DualCertificate {
 public:
  /// `explicit_form`: the spectrum of S itself, instead of S with the translations eliminated.
  DualCertificate(const ChordalProblem& problem, const Eigen::MatrixXd& point,
                  bool explicit_form = false);

  /// The bound that Cholesky factorisations prove.
  DualBound Bound();

  /// `shift` as in DualBound, or above. Throws std::runtime_error if S has no such shift.
  DualSpectrum Spectrum(double shift, int count);

 private:
  bool Factorize(double shift);
  double ScaleOfShifts() const;
  double SmallestPositiveShift(double shift);
  Eigen::MatrixXd ToUnknowns(const Eigen::MatrixXd& v) const;
  Eigen::MatrixXd FromUnknowns(const Eigen::MatrixXd& v) const;
  Eigen::MatrixXd KnownNullSpace() const;

  const ChordalProblem& problem_;
  const Eigen::MatrixXd& point_;
  const int d_, b_;
  const bool explicit_;
  double cost_, trace_, rounding_;
  double scale_ = 0;          ///< largest diagonal entry of S
  double mean_ = 0;           ///< mean diagonal entry at the rotations
  Eigen::MatrixXd diagonal_;  ///< diagonal blocks of S
  Eigen::MatrixXd residual_;  ///< X S
  EdgeMatrix matrix_;
};

}  // namespace bundle
