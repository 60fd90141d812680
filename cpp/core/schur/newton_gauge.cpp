#include "core/schur/newton_gauge.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>

#include "core/dense/decompositions.h"
#include "core/model/problem_factors.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

constexpr double kSingular = 1e-14;  // of N^T D^2 N in units of its diagonal

/// True if a factor on this rank may fix the position or orientation of the world.
bool MayHoldWorld(const AdjustmentProblem& problem, const ParameterLayout& layout,
                  const EliminationPlan& plan) {
  if (DependsOnPoses(problem) || plan.num_points() > plan.num_free_points) return true;
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  const FreeParameters& free = layout.free();
  for (int i = 0; i < problem.num_images; ++i) {
    if (observed[i] == 0) continue;
    const int frame = problem.FrameOf(i);
    const uint8_t bits = frame < 0 ? free.pose[i] : free.frame[frame];
    if (bits != FreeParameters::kWholePose) return true;
  }
  return false;
}

}  // namespace

void NewtonGauge::Sums::Add(const Row& moves, double d_squared, double q) {
  const Row weighted = d_squared * moves;
  square += moves.transpose() * weighted;
  product += q * weighted;
}

void NewtonGauge::Sums::Add(const Sums& other) {
  square += other.square;
  product += other.product;
}

int NewtonGauge::Degrees(const AdjustmentProblem& problem, const ParameterLayout& layout,
                         const EliminationPlan& plan) {
  const double held = MayHoldWorld(problem, layout, plan) ? 1 : 0;
  if (SumOverRanks(problem.division.communicator, held) > 0) return 0;
  return problem.num_frames > 0 ? kNumGaugeDirections - 1 : kNumGaugeDirections;
}

NewtonGauge::NewtonGauge(const AdjustmentProblem& problem, const ParameterLayout& layout,
                         int degrees, const CameraStates& cameras,
                         const LargeVector<double>& points)
    : degrees_(degrees),
      centre_(MeanCentre(cameras, problem.num_images).data()),
      unknowns_(GaugeDirections(problem, layout, cameras)),
      points_(points) {}

NewtonGauge::Row NewtonGauge::OfUnknown(size_t unknown) const {
  Row row = Eigen::Map<const Row>(&unknowns_[unknown * kNumGaugeDirections]);
  if (degrees_ < kNumGaugeDirections) row[kNumGaugeDirections - 1] = 0;
  return row;
}

Eigen::Vector3d NewtonGauge::FromCentre(int point) const {
  return Eigen::Map<const Eigen::Vector3d>(&points_[3 * size_t(point)]) - centre_;
}

void NewtonGauge::AddPoints(int first, int last, const LargeVector<double>& d_squared,
                            const LargeVector<double>& q, Sums* sums) const {
  const double scale = degrees_ == kNumGaugeDirections ? 1 : 0;
  for (int j = 0; j < 3; ++j) {
    const int next = (j + 1) % 3, after = (j + 2) % 3;
    const int columns[] = {j, 3 + next, 3 + after, 6};
    Eigen::Matrix4d square = Eigen::Matrix4d::Zero();
    Eigen::Vector4d product = Eigen::Vector4d::Zero();
    for (int point = first; point < last; ++point) {
      const Eigen::Vector3d from_centre = FromCentre(point);
      const size_t at = 3 * size_t(point) + j;
      // (e_k x X)_j
      const Eigen::Vector4d row(1, from_centre[after], -from_centre[next], scale * from_centre[j]);
      const Eigen::Vector4d weighted = d_squared[at] * row;
      square += weighted * row.transpose();
      product += q[at] * weighted;
    }
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) sums->square(columns[a], columns[b]) += square(a, b);
      sums->product[columns[a]] += product[a];
    }
  }
}

Eigen::Vector3d NewtonGauge::MoveOfPoint(int point, const Row& k) const {
  const Eigen::Vector3d from_centre = FromCentre(point), turn = k.segment<3>(3).transpose();
  return k.head<3>().transpose() + turn.cross(from_centre) + k[6] * from_centre;
}

NewtonGauge::Row NewtonGauge::Solve(const Sums& sums) const {
  return SolveSemidefinite(sums.square, sums.product.transpose(), kSingular).transpose();
}

}  // namespace bundle
