#include "core/pose_graph/certificate.h"

#include <algorithm>
#include <utility>

#include "core/pose_graph/chordal_newton.h"
#include "core/pose_graph/dual_certificate.h"
#include "core/pose_graph/rank_staircase.h"

namespace bundle {

using Eigen::MatrixXd;

namespace {

PosesCertificate CertifyPoint(const ChordalProblem& problem, const CertifyOptions& options,
                              const double* first, MatrixXd* point, Eigen::VectorXd* direction) {
  PosesCertificate found;
  found.newton = MinimizeChordal(problem, {options.max_steps, true, options.progress}, point);
  DualCertificate certificate(problem, *point);
  found.bound = certificate.Bound();
  const double shift = (found.bound.holds ? 1 : 1.5) * found.bound.shift;
  DualSpectrum spectrum = certificate.Spectrum(shift, options.num_eigenvalues);
  found.eigenvalue_of_rows = spectrum.of_rows;
  found.eigenvalues = std::move(spectrum.eigenvalues);
  if (options.explicit_form) {
    DualCertificate whole(problem, *point, true);
    found.eigenvalues = whole.Spectrum(shift, options.num_eigenvalues).eigenvalues;
  }
  *direction = std::move(spectrum.direction);
  found.poses = PosesOfPoint(problem, *point, first);
  return found;
}

}  // namespace

GraphCertificate CertifyGraph(const PoseGraphView& view, const double* kappa, const double* tau,
                              const CertifyOptions& options) {
  const ChordalProblem problem = MakeChordalProblem(view, kappa, tau, options.num_threads);
  const double* const first = view.poses;
  MatrixXd point = PointOfPoses(problem, view.poses);
  GraphCertificate found;
  Eigen::VectorXd direction;
  found.of_poses = CertifyPoint(problem, options, first, &point, &direction);
  const int max_rank = std::min(options.max_rank, kMostRank);
  if (found.of_poses.bound.holds || max_rank <= view.dimension()) return found;
  StaircaseOutcome climbed = ClimbStaircase(problem, found.of_poses.bound, std::move(point),
                                            std::move(direction), max_rank, options.progress);
  found.rank = climbed.rank;
  found.relaxed_cost = climbed.relaxed_cost;
  found.relaxed_bound = climbed.relaxed_bound;
  found.after_staircase = CertifyPoint(problem, options, first, &climbed.point, &direction);
  return found;
}

}  // namespace bundle
