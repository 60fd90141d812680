/// Part of ReducedSystem (reduced_system.h): rows of the Jacobian other than observations of
/// eliminated points, and the decision whether points are eliminated from rows.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/covariance/reduced_system.h"
#include "core/model/factor_costs.h"

namespace bundle {
namespace {

/// Limit of the sum of cubes of track lengths. Long sums take about 100 multiplications per unit.
constexpr double kMaxTrackCubes = 3e5;

}  // namespace

bool ReducedSystem::is_small() const {
  if (!structure_.dense || num_unknowns() == 0) return false;
  double cubes = 0;
  for (const int p : point_order_) {
    const auto track = static_cast<double>(tracks_.begin[p + 1] - tracks_.begin[p]);
    cubes += track * track * track;
  }
  return cubes <= kMaxTrackCubes;
}

void ReducedSystem::EliminateByRows() {
  ForFactors([&](const FactorRows& factor) {
    if (factor.points.empty()) return;
    std::vector<double>& to = prior_rows_[factor.points.front()];
    to.insert(to.end(), factor.jacobian.begin(), factor.jacobian.end());
  });
  by_rows_ = true;
}

const std::vector<double>& ReducedSystem::point_prior_rows(int point) const {
  static const std::vector<double> none;
  const auto at = prior_rows_.find(point);
  return at == prior_rows_.end() ? none : at->second;
}

void ReducedSystem::ForObservationsOfFixedPoints(
    const std::function<void(const ObservationRows&)>& visit) const {
  ObservationRows rows;
  for (int64_t i = 0; i < problem_.num_observations; ++i) {
    if (layout_.point_is_free(problem_.observation_point[i])) continue;
    if (evaluator_->Evaluate(i, &rows)) visit(rows);
  }
}

void ReducedSystem::ForFactors(const std::function<void(const FactorRows&)>& visit) const {
  if (problem_.factors == nullptr) return;
  int index = -1;
  for (const std::unique_ptr<Factor>& factor : problem_.factors->factors) {
    const ChartedFactor charted(*factor, problem_, layout_);
    FactorRows rows;
    rows.factor = ++index;
    rows.num_rows = charted.num_residuals();
    rows.num_measurements = factor->num_measurements();
    rows.points = charted.unknowns().points;
    for (const int block : charted.unknowns().blocks) {
      const CameraBlock& of = layout_.blocks()[block];
      for (int k = 0; k < of.size; ++k) rows.unknowns.push_back(of.offset + k);
    }
    std::vector<const double*> points;
    for (const int point : rows.points) points.push_back(problem_.points + 3 * int64_t{point});
    const int columns = charted.num_columns();
    rows.residual.resize(rows.num_rows);
    rows.jacobian.resize(static_cast<size_t>(rows.num_rows) * columns);
    if (!charted.Evaluate(states(), points.data(), rows.residual.data(),
                          columns == 0 ? nullptr : rows.jacobian.data())) {
      continue;
    }
    double none;
    ApplyLoss(*factor, columns, rows.residual.data(), columns == 0 ? &none : rows.jacobian.data());
    visit(rows);
  }
}

/// Adds the blocks of S of points that are not eliminated. The passes have added those of the
/// images that see them.
void ReducedSystem::AddKeptPoints() {
  if (layout_.kept_points().empty()) return;
  BlockSystem& system = schur_->system();
  ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
    if (rows.num_image_blocks == rows.num_blocks) return;
    const int kept = rows.num_image_blocks, block = rows.block[kept];
    for (int b = 0; b < rows.num_blocks; ++b) {
      const bool is_below = rows.block[b] > block;
      const int i = is_below ? b : kept, j = is_below ? kept : b;  // row and column
      const int64_t entry = structure_.Entry(rows.block[j], rows.block[i]);
      for (int c = 0; c < rows.size[j]; ++c) {
        for (int r = b == kept ? c : 0; r < rows.size[i]; ++r) {
          double& to = system.values[structure_.ValueIndex(rows.block[j], entry, r, c)];
          for (int k = 0; k < 2; ++k) {
            to += rows.jacobian[i][k * rows.size[i] + r] * rows.jacobian[j][k * rows.size[j] + c];
          }
        }
      }
    }
    for (int r = 0; r < 3; ++r) {
      for (int k = 0; k < 2; ++k) {
        system.rhs[structure_.offset[block] + r] -=
            rows.jacobian[kept][3 * k + r] * rows.residual[k];
      }
    }
  });
}

}  // namespace bundle
