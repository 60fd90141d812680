#pragma once

/// Certificate of the poses of a graph, and poses of lower cost if it fails.

#include <cstdint>
#include <vector>

#include "core/interface/summary.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Largest number of rows of a point of the relaxation.
constexpr int kMostRank = 10;

/// Result of Newton's method on a chordal cost F (chordal_newton.cpp).
struct ChordalNewtonOutcome {
  double initial_cost = 0;
  double cost = 0;
  int num_steps = 0;
  bool converged = false;
  /// The Hessian at the end is positive semidefinite (up to rounding): no saddle.
  bool is_minimum = false;
};

/// Lower bound of F (dual_certificate.cpp).
struct DualBound {
  double trace = 0;    ///< tr Lambda, F at a critical point
  double shift = 0;    ///< S + shift diag(I, 0) is positive definite, by Cholesky
  double bound = 0;    ///< F of any poses is at least tr Lambda - shift n d
  bool holds = false;  ///< shift is as small as for a global optimum
};

struct CertifyOptions {
  int max_steps = 40;          ///< Newton steps at the rank of poses
  int num_eigenvalues = 3;     ///< eigenvalues of S outside of the rows of X
  int max_rank = kMostRank;    ///< below or equal to the dimension: no staircase
  bool explicit_form = false;  ///< eigenvalues of S with translations (dual_certificate.h)
  int num_threads = 1;
  ProgressCallback progress;  ///< after each Newton step, with F as the cost; false: Interrupted
};

/// Certificate of the critical point that Newton's method finds from poses.
struct PosesCertificate {
  ChordalNewtonOutcome newton;
  DualBound bound;
  std::vector<double> eigenvalues;  ///< smallest ones of S outside of the rows of X, ascending
  double eigenvalue_of_rows = 0;    ///< smallest Rayleigh quotient of the rows of X
  std::vector<double> poses;        ///< the critical point, in the layout of the graph
};

struct GraphCertificate {
  PosesCertificate of_poses;
  int rank = 0;  ///< last rank of the staircase; 0: not climbed
  double relaxed_cost = 0;
  DualBound relaxed_bound;
  PosesCertificate after_staircase;
};

/// `kappa`, `tau`: weights of the edges of the view, above 0; the graph is connected.
GraphCertificate CertifyGraph(const PoseGraphView& view, const double* kappa, const double* tau,
                              const CertifyOptions& options);

}  // namespace bundle
