/// Part of ReducedSystem (reduced_system.h): points with directions that no residual determines. A
/// first linearisation finds them; a second one holds them constant by factors on these points
/// alone (point_blocks.h).

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "core/covariance/gauge_sums.h"
#include "core/covariance/point_passes.h"
#include "core/covariance/reduced_system.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

/// Row of a null direction that no other factor holds: residual 0, one point.
class HeldDirections final : public Factor {
 public:
  /// `root`: 3 x 3, J^T J the information of the directions.
  HeldDirections(int variable, const double root[9])
      : Factor({"null directions of a point", {variable}, LossType::kTrivial, 1},
               {Retraction(Manifold::kEuclidean, 3)}, 3) {
    std::copy_n(root, 9, root_);
  }

  bool Evaluate(const double* const* /*values*/, double* residual,
                double* const* jacobians) const override {
    std::fill_n(residual, 3, 0.0);
    if (jacobians != nullptr && jacobians[0] != nullptr) std::copy_n(root_, 9, jacobians[0]);
    return true;
  }

 private:
  double root_[9];
};

/// A factor that another list owns.
class BorrowedFactor final : public Factor {
 public:
  explicit BorrowedFactor(const Factor& factor)
      : Factor({factor.name(), factor.blocks(), factor.loss(), factor.loss_scale()},
               factor.retractions(), factor.num_residuals()),
        factor_(factor) {}

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override {
    return factor_.Evaluate(values, residual, jacobians);
  }
  int num_measurements() const override { return factor_.num_measurements(); }
  bool IsThreadSafe() const override { return factor_.IsThreadSafe(); }

 private:
  const Factor& factor_;
};

}  // namespace

void ReducedSystem::AddResiduals(int point, const PointBlocks& blocks, const PointAssembler& rows,
                                 PointSums* sums) const {
  double gradient[3] = {}, step[3];
  if (!tracks_.prior_gradient.empty()) {
    std::copy_n(&tracks_.prior_gradient[3 * size_t(point)], 3, gradient);
  }
  for (int i = 0; i < rows.num_rows(); ++i) {
    const double *const r = rows.row(i).residual, *const j = rows.row(i).point;
    sums->squares += r[0] * r[0] + r[1] * r[1];
    for (int k = 0; k < 3; ++k) gradient[k] += j[k] * r[0] + j[3 + k] * r[1];
  }
  sums->num_residuals += 2 * rows.num_rows();
  VectorMatrix3(gradient, blocks.inverse, step);
  for (int k = 0; k < 3; ++k) sums->decrease += 0.5 * gradient[k] * step[k];
}

void ReducedSystem::FindNullPoints() {
  std::vector<std::vector<NullPoint>> found(num_threads_);
  std::vector<PointSums> sums(num_threads_);
  unclear_points_ = point_order_;
  if (schur_ != nullptr) {
    PointPasses::Found clear = PointPasses(*schur_, num_threads_).Survey(gauge_sums_.get());
    point_sums_ = {clear.squares, clear.num_residuals, clear.decrease};
    unclear_points_ = std::move(clear.unclear);
  }
  ForPoints(num_threads_, unclear_points_,
            [&](int point, const PointBlocks& blocks, const PointAssembler& rows, int thread) {
              AddResiduals(point, blocks, rows, &sums[thread]);
              if (gauge_sums_ != nullptr) gauge_sums_->AddPoint(point, blocks, rows, thread);
              if (blocks.num_null == 0) return;
              NullPoint null;
              null.point = point;
              null.num_null = blocks.num_null;
              std::copy_n(blocks.null_projector, 9, null.projector);
              // The longest column of the projector; with one direction, a multiple of it.
              int longest = 0;
              for (int k = 1; k < 3; ++k) {
                if (blocks.null_projector[4 * k] > blocks.null_projector[4 * longest]) longest = k;
              }
              const double norm = std::sqrt(blocks.null_projector[4 * longest]);
              for (int k = 0; k < 3; ++k)
                null.direction[k] = blocks.null_projector[3 * k + longest] / norm;
              null.root = blocks.largest > 0 ? std::sqrt(blocks.largest) : 1;
              found[thread].push_back(null);
            });
  if (gauge_sums_ != nullptr) gauge_sums_->Finish();
  for (const PointSums& of_thread : sums) {
    point_sums_.squares += of_thread.squares;
    point_sums_.num_residuals += of_thread.num_residuals;
    point_sums_.decrease += of_thread.decrease;
  }
  for (const std::vector<NullPoint>& of_thread : found) {
    null_points_.insert(null_points_.end(), of_thread.begin(), of_thread.end());
  }
  std::sort(null_points_.begin(), null_points_.end(),
            [](const NullPoint& a, const NullPoint& b) { return a.point < b.point; });
}

void ReducedSystem::HoldNullDirections() {
  if (null_points_.empty()) return;
  if (problem_.factors != nullptr) {
    factors_.variables = problem_.factors->variables;
    for (const std::unique_ptr<Factor>& factor : problem_.factors->factors) {
      factors_.factors.push_back(std::make_unique<BorrowedFactor>(*factor));
    }
  }
  for (const NullPoint& null : null_points_) {
    double root[9];
    for (int k = 0; k < 9; ++k) root[k] = null.root * null.projector[k];
    factors_.factors.push_back(
        std::make_unique<HeldDirections>(static_cast<int>(factors_.variables.size()), root));
    factors_.variables.push_back({ProblemVariable::Kind::kPoint, null.point});
  }
  view_.factors = &factors_;
}

}  // namespace bundle
