#include "core/schur/camera_factors.h"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>

#include "core/model/factor_costs.h"
#include "core/parallel/blas.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

constexpr double kNoValue = std::numeric_limits<double>::quiet_NaN();
constexpr int kPriorSums = 12;
/// Number of columns from which J^T J is computed by the BLAS.
constexpr int kColumnsWorthBlas = 64;

/// J^T J of a row-major J. Uses one thread, so that its bits do not depend on the number of
/// threads.
void SquareOf(const double* jacobian, int rows, int columns, std::vector<double>* square) {
  square->resize(static_cast<size_t>(columns) * columns);
  const double one = 1, zero = 0;
  const ScopedBlasThreads blas_threads(1);
  dgemm_("N", "T", &columns, &columns, &rows, &one, jacobian, &columns, jacobian, &columns, &zero,
         square->data(), &columns);
}

}  // namespace

namespace {

bool TouchesPoint(const Factor& factor, const AdjustmentProblem& problem) {
  const std::vector<int>& blocks = factor.blocks();
  return std::any_of(blocks.begin(), blocks.end(), [&](int block) {
    return problem.factors->variables[block].kind == ProblemVariable::Kind::kPoint;
  });
}

}  // namespace

CameraFactors::CameraFactors(const AdjustmentProblem& problem, const ParameterLayout& layout,
                             const BlockStructure& structure, const EliminationPlan& plan)
    : structure_(structure), diagonal_begin_(DiagonalBlockOffsets(structure)) {
  if (problem.factors != nullptr) AddAll(problem, layout, plan);
  FindKinds(problem);
}

void CameraFactors::AddAll(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const EliminationPlan& plan) {
  std::vector<int> place;  // place in the plan of each point of the problem
  for (const auto& factor : problem.factors->factors) {
    if (!IsFirst(problem.division.communicator) && !TouchesPoint(*factor, problem)) continue;
    ChartedFactor charted(*factor, problem, layout);
    if (charted.is_fixed()) {
      fixed_.push_back(std::move(charted));
      continue;
    }
    num_residuals_ += charted.num_residuals();
    if (charted.unknowns().points.empty()) {
      AddCameras(std::move(charted), layout);
      continue;
    }
    if (place.empty()) {
      place.assign(problem.num_points, -1);
      for (int p = 0; p < plan.num_free_points; ++p) place[plan.point[p]] = p;
      point_prior_.assign(plan.num_points(), -1);
    }
    const int point = place[charted.unknowns().points.front()];
    AddPoint(std::move(charted), point);
  }
}

void CameraFactors::FindKinds(const AdjustmentProblem& problem) {
  std::vector<double> kinds;
  for (const OfCameras& of : of_cameras_) kinds.push_back(KindOf(of.factor.factor(), problem));
  for (const OfPoint& of : of_points_) kinds.push_back(KindOf(of.factor.factor(), problem));
  const auto sort = [](std::vector<double>* values) {
    std::sort(values->begin(), values->end());
    values->erase(std::unique(values->begin(), values->end()), values->end());
  };
  std::vector<double> all = kinds;
  sort(&all);
  all = ConcatenateOverRanks(problem.division.communicator, all);
  sort(&all);
  num_kinds_ = all.size();
  for (const double kind : kinds) {
    kind_.push_back(std::lower_bound(all.begin(), all.end(), kind) - all.begin());
  }
  std::vector<double> own(num_kinds_);
  auto kind = kind_.begin();
  const auto add = [&](const ChartedFactor& factor) {
    own[*kind++] += 0.5 * factor.num_residuals();
  };
  for (const OfCameras& of : of_cameras_) add(of.factor);
  for (const OfPoint& of : of_points_) add(of.factor);
  const auto parts = ConcatenateOverRanks(problem.division.communicator, own);
  expected_costs_.assign(num_kinds_, 0.0);
  for (size_t k = 0; k < parts.size(); ++k) expected_costs_[k % num_kinds_] += parts[k];
}

void CameraFactors::AddCameras(ChartedFactor factor, const ParameterLayout& layout) {
  OfCameras of{std::move(factor), 0, 0, {}, {}};
  of.first_residual = static_cast<int64_t>(residuals_.size());
  of.first_entry = static_cast<int64_t>(jacobians_.size());
  const std::vector<int>& blocks = of.factor.unknowns().blocks;
  for (size_t a = 0; a < blocks.size(); ++a) {
    const CameraBlock& block = layout.blocks()[blocks[a]];
    for (int k = 0; k < block.size; ++k) of.unknown.push_back(block.offset + k);
    for (size_t b = a; b < blocks.size(); ++b) {
      of.entry.push_back(structure_.Entry(blocks[a], blocks[b]));
    }
  }
  const auto rows = static_cast<size_t>(of.factor.num_residuals());
  residuals_.resize(residuals_.size() + rows);
  jacobians_.resize(jacobians_.size() + rows * of.unknown.size());
  of_cameras_.push_back(std::move(of));
}

void CameraFactors::AddPoint(ChartedFactor factor, int point) {
  has_other_rows_ = has_other_rows_ || factor.num_residuals() != 2;
  if (point_prior_[point] < 0) {
    point_prior_[point] = static_cast<int32_t>(prior_sums_.size() / kPriorSums);
    prior_sums_.resize(prior_sums_.size() + kPriorSums);
  }
  of_points_.push_back({std::move(factor), point});
}

double CameraFactors::FixedCost(const CameraStates& cameras) const {
  double cost = 0;
  for (const ChartedFactor& factor : fixed_) cost += factor.Cost(cameras, nullptr);
  return cost;
}

double CameraFactors::Linearize(const CameraStates& cameras, const double* points) {
  double cost = 0;
  for (const OfCameras& of : of_cameras_) {
    double* const residual = residuals_.data() + of.first_residual;
    double* const jacobian = jacobians_.data() + of.first_entry;
    if (!of.factor.Evaluate(cameras, nullptr, residual, jacobian)) return kNoValue;
    cost += ApplyLoss(of.factor.factor(), of.factor.num_columns(), residual, jacobian);
  }
  std::fill(prior_sums_.begin(), prior_sums_.end(), 0.0);
  std::vector<double> residual, jacobian;
  for (const OfPoint& of : of_points_) {
    const int rows = of.factor.num_residuals();
    residual.resize(rows);
    jacobian.resize(3 * static_cast<size_t>(rows));
    const double* const point = points + 3 * int64_t{of.point};
    if (!of.factor.Evaluate(cameras, &point, residual.data(), jacobian.data())) return kNoValue;
    cost += ApplyLoss(of.factor.factor(), 3, residual.data(), jacobian.data());
    double* const sums = prior_sums_.data() + int64_t{kPriorSums} * point_prior_[of.point];
    for (int r = 0; r < rows; ++r) {
      const double* const row = jacobian.data() + 3 * static_cast<size_t>(r);
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) sums[4 * i + j] += row[i] * row[j];
        sums[4 * i + 3] += row[i] * residual[r];
      }
    }
  }
  return cost;
}

void CameraFactors::AddTo(CameraSums* sums) const {
  double* const values = sums->system.values.data();
  std::vector<double>& camera_diagonal = sums->system.camera_diagonal;
  std::vector<double> square;
  for (const OfCameras& of : of_cameras_) {
    const double* const residual = residuals_.data() + of.first_residual;
    const double* const jacobian = jacobians_.data() + of.first_entry;
    const int rows = of.factor.num_residuals(), columns = of.factor.num_columns();
    if (columns >= kColumnsWorthBlas) SquareOf(jacobian, rows, columns, &square);
    const auto product = [&](int i, int j) {
      if (columns >= kColumnsWorthBlas) return square[static_cast<size_t>(i) * columns + j];
      double sum = 0;
      for (int r = 0; r < rows; ++r) sum += jacobian[r * columns + i] * jacobian[r * columns + j];
      return sum;
    };
    for (int j = 0; j < columns; ++j) {
      const double gradient = ResidualTimesColumn(residual, jacobian, rows, columns, j);
      sums->gradient[of.unknown[j]] += gradient;
      sums->system.rhs[of.unknown[j]] -= gradient;
    }
    const std::vector<int>& blocks = of.factor.unknowns().blocks;
    const std::vector<int>& begin = of.factor.column_begin();
    size_t pair = 0;
    for (size_t a = 0; a < blocks.size(); ++a) {
      const int size = begin[a + 1] - begin[a];
      for (size_t b = a; b < blocks.size(); ++b, ++pair) {
        for (int i = 0; i < size; ++i) {
          const int first = a == b ? i : 0;  // diagonal blocks: the lower triangle only
          for (int j = first; j < begin[b + 1] - begin[b]; ++j) {
            const double sum = product(begin[a] + i, begin[b] + j);
            values[structure_.ValueIndex(blocks[a], of.entry[pair], j, i)] += sum;
            if (a != b) continue;
            if (i == j) sums->squared_norms[of.unknown[begin[a] + i]] += sum;
            if (!camera_diagonal.empty()) {
              camera_diagonal[diagonal_begin_[blocks[a]] + int64_t{i} * size + j] += sum;
            }
          }
        }
      }
    }
  }
}

double CameraFactors::Cost(const CameraStates& cameras, const double* points,
                           std::vector<DoubleDouble>* kinds) const {
  double total = 0;
  kinds->assign(num_kinds_, {});
  auto kind = kind_.begin();
  const auto add = [&](double cost) {
    total += cost;
    (*kinds)[*kind++].Add(cost);
  };
  for (const OfCameras& of : of_cameras_) add(of.factor.Cost(cameras, nullptr));
  for (const OfPoint& of : of_points_) {
    const double* const point = points + 3 * int64_t{of.point};
    add(of.factor.Cost(cameras, &point));
  }
  return total;
}

namespace {

double Along(const double* row, const std::vector<int>& unknown, const std::vector<double>& step) {
  double sum = 0;
  for (size_t k = 0; k < unknown.size(); ++k) sum += row[k] * step[unknown[k]];
  return sum;
}

}  // namespace

double CameraFactors::ModelCostChange(const std::vector<double>& step) const {
  double change = 0;
  for (const OfCameras& of : of_cameras_) {
    const double* row = jacobians_.data() + of.first_entry;
    for (int r = 0; r < of.factor.num_residuals(); ++r, row += of.unknown.size()) {
      const double model = Along(row, of.unknown, step);
      change -= model * (residuals_[of.first_residual + r] + 0.5 * model);
    }
  }
  return change;
}

void CameraFactors::AddProducts(const std::vector<double>& p, const std::vector<double>& q,
                                DoglegProducts* products) const {
  for (const OfCameras& of : of_cameras_) {
    const double* row = jacobians_.data() + of.first_entry;
    for (int r = 0; r < of.factor.num_residuals(); ++r, row += of.unknown.size()) {
      const double along_p = Along(row, of.unknown, p), along_q = Along(row, of.unknown, q);
      products->j_pp += along_p * along_p;
      products->j_pq += along_p * along_q;
      products->j_qq += along_q * along_q;
    }
  }
}

double CameraFactors::Slope(const CameraStates& cameras, const double* points,
                            const std::vector<double>& step, const double* points_step) const {
  double slope = 0;
  std::vector<double> residual, jacobian;
  const auto linearize = [&](const ChartedFactor& factor, const double* const* point) {
    const auto rows = static_cast<size_t>(factor.num_residuals());
    residual.resize(rows);
    jacobian.resize(rows * static_cast<size_t>(factor.num_columns()));
    if (!factor.Evaluate(cameras, point, residual.data(), jacobian.data())) slope = kNoValue;
    ApplyLoss(factor.factor(), factor.num_columns(), residual.data(), jacobian.data());
  };
  for (const OfCameras& of : of_cameras_) {
    linearize(of.factor, nullptr);
    const double* row = jacobian.data();
    for (const double r : residual) {
      slope += r * Along(row, of.unknown, step);
      row += of.unknown.size();
    }
  }
  for (const OfPoint& of : of_points_) {
    const double* const point = points + 3 * int64_t{of.point};
    linearize(of.factor, &point);
    const double* const d = points_step + 3 * int64_t{of.point};
    const double* row = jacobian.data();
    for (const double r : residual) {
      slope += r * (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
      row += 3;
    }
  }
  return slope;
}

}  // namespace bundle
