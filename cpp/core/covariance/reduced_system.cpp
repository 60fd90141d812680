#include "core/covariance/reduced_system.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <utility>

#include "core/error.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"

namespace bundle {
namespace {

/// Below so many unknowns even the structure of S costs more than its dense factorisation.
constexpr int kUnknownsWorthALook = 300;

/// The share of a direction that is not held by anything else: residual 0, of one point.
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
  bool IsThreadSafe() const override { return factor_.IsThreadSafe(); }

 private:
  const Factor& factor_;
};

void RefuseUnsupported(const PreparedSolve& prepared) {
  if (!prepared.factor_for_ceres.empty()) {
    throw InputError("factors: expected factors of images and cameras, or of one point, found " +
                     prepared.factor_for_ceres);
  }
  for (size_t p = 0; p < prepared.track_lengths.size(); ++p) {
    if (prepared.track_lengths[p] <= kMaxTrackLength) continue;
    throw InputError("observation_point: expected at most " + std::to_string(kMaxTrackLength) +
                     " observations of a point, found " +
                     std::to_string(prepared.track_lengths[p]) + " at [" + std::to_string(p) + "]");
  }
}

}  // namespace

ReducedSystem::ReducedSystem(const ProblemView& problem, const SolveOptions& options)
    : ReducedSystem(problem, options, PrepareSolve(problem, options)) {}

ReducedSystem::ReducedSystem(const ProblemView& problem, const SolveOptions& options,
                             PreparedSolve prepared)
    : problem_(problem),
      num_threads_(EffectiveNumThreads(options.num_threads)),
      warnings_(std::move(prepared.warnings)),
      layout_(std::move(prepared.layout)),
      view_(problem) {
  RefuseUnsupported(prepared);
  Order(options);
  evaluator_ = std::make_unique<ObservationEvaluator>(problem_, layout_, options);
  tracks_ = PointAssembler::FindTracks(problem_, layout_, states());
  FindNullPoints();
  HoldNullDirections();
  if (num_unknowns() > 0) LinearizeSchur(options);
}

ReducedSystem::~ReducedSystem() = default;

/// The blocks of the layout in the order of the elimination, and the solver.
void ReducedSystem::Order(const SolveOptions& options) {
  TakeBlasBuffers();
  const int threads = options.deterministic ? 1 : num_threads_;
  std::vector<int> sizes;
  for (const CameraBlock& block : layout_.blocks()) sizes.push_back(block.size);
  if (layout_.state_size() < kUnknownsWorthALook) {
    structure_ = DenseStructure(sizes);
    solver_ = MakeDenseSolver(structure_, threads);
    return;
  }
  structure_ = SparseStructure(sizes, FindCoupledBlocks(problem_, layout_, num_threads_));
  const FillOrdering ordering = FindFillOrdering(structure_);
  layout_.Reorder(ordering.order);
  structure_ = bundle::Reorder(structure_, ordering.order);
  solver_ = MakeSparseSolver(ordering, threads, &structure_);
  RefuseTooMuchMemory(LinearSolverType::kSparseSchur,
                      sizeof(double) * static_cast<double>(structure_.num_values));
}

void ReducedSystem::FindNullPoints() {
  std::vector<std::vector<std::pair<NullPoint, PointBlocks>>> found(num_threads_);
  ForPoints([&](int point, const PointBlocks& blocks, const PointAssembler&, int thread) {
    if (blocks.num_null == 0) return;
    NullPoint null;
    null.point = point;
    null.num_null = blocks.num_null;
    std::copy_n(blocks.null_projector, 9, null.projector);
    // A column of the projector, the longest: for one direction, a multiple of it.
    int longest = 0;
    for (int k = 1; k < 3; ++k) {
      if (blocks.null_projector[4 * k] > blocks.null_projector[4 * longest]) longest = k;
    }
    const double norm = std::sqrt(blocks.null_projector[4 * longest]);
    for (int k = 0; k < 3; ++k) null.direction[k] = blocks.null_projector[3 * k + longest] / norm;
    found[thread].emplace_back(null, blocks);
  });
  for (const auto& of_thread : found) {
    for (const auto& [null, blocks] : of_thread) {
      null_points_.push_back(null);
      // As much as is known of the point's other directions.
      const double known = blocks.eigenvalues[2] > 0 ? std::sqrt(blocks.eigenvalues[2]) : 1;
      for (int k = 0; k < 9; ++k) null_information_.push_back(known * blocks.null_projector[k]);
    }
  }
}

void ReducedSystem::HoldNullDirections() {
  if (null_points_.empty()) return;
  if (problem_.factors != nullptr) {
    factors_.variables = problem_.factors->variables;
    for (const std::unique_ptr<Factor>& factor : problem_.factors->factors) {
      factors_.factors.push_back(std::make_unique<BorrowedFactor>(*factor));
    }
  }
  for (size_t i = 0; i < null_points_.size(); ++i) {
    factors_.factors.push_back(std::make_unique<HeldDirections>(
        static_cast<int>(factors_.variables.size()), &null_information_[9 * i]));
    factors_.variables.push_back({ProblemVariable::Kind::kPoint, null_points_[i].point});
  }
  view_.factors = &factors_;
}

void ReducedSystem::LinearizeSchur(const SolveOptions& options) {
  schur_ = std::make_unique<SchurProblem>(view_, layout_, options, structure_, solver_.get());
  if (!schur_->Linearize(0).is_finite) {
    throw InputError("problem: expected finite residuals and derivatives of all observations");
  }
  held_ = schur_->active_columns();
  if (std::none_of(held_.begin(), held_.end(), [](uint8_t bit) { return bit != 0; })) held_.clear();
  if (!held_.empty()) evaluator_->Hold(held_);
  std::vector<double>& s = values();
  for (int j = 0; j < structure_.num_blocks(); ++j) {
    const int64_t entry = structure_.Entry(j, j);
    for (int k = 0; k < structure_.block_size(j); ++k) {
      double& on_diagonal = s[structure_.ValueIndex(j, entry, k, k)];
      if (!held_.empty() && held_[structure_.offset[j] + k] != 0) on_diagonal = 1;
      diagonal_.push_back(on_diagonal);
    }
  }
}

std::vector<double>& ReducedSystem::values() {
  return schur_ == nullptr ? no_values_ : schur_->system().values;
}

LinearSolution ReducedSystem::Factorize() {
  if (schur_ == nullptr) return {};
  return solver_->Factorize(&schur_->system(), diagonal_);
}

LinearSolution ReducedSystem::Solve(const double* rhs, int num_rhs, double* x) {
  if (schur_ == nullptr) return {};
  return solver_->Solve(rhs, num_rhs, 0, x);
}

LinearSolution ReducedSystem::Invert() {
  return schur_ == nullptr ? LinearSolution{} : solver_->InvertBlocks();
}

LinearSolution ReducedSystem::Solve(const FullVectors& rhs, FullVectors* x) {
  const int n = num_unknowns(), columns = rhs.num_columns;
  const size_t num_coordinates = 3 * static_cast<size_t>(problem_.num_points);
  std::vector<std::vector<double>> eliminated(num_threads_);
  ForPoints([&](int point, const PointBlocks& blocks, const PointAssembler&, int thread) {
    std::vector<double>& sum = eliminated[thread];
    sum.resize(static_cast<size_t>(n) * columns);
    for (int m = 0; m < columns; ++m) {
      const double* const b = &rhs.points[m * num_coordinates + 3 * size_t(point)];
      for (size_t i = 0; i < blocks.blocks.size(); ++i) {
        double* to = &sum[size_t(m) * n + structure_.offset[blocks.blocks[i]]];
        for (int row = blocks.begin[i]; row < blocks.begin[i + 1]; ++row, ++to) {
          const double* const y = &blocks.y[3 * size_t(row)];
          *to += y[0] * b[0] + y[1] * b[1] + y[2] * b[2];
        }
      }
    }
  });
  std::vector<double> reduced = rhs.cameras;
  for (const std::vector<double>& sum : eliminated) {
    for (size_t i = 0; i < sum.size(); ++i) reduced[i] -= sum[i];
  }
  for (size_t i = 0; i < reduced.size() && !held_.empty(); ++i) {
    if (held_[i % n] != 0) reduced[i] = 0;
  }
  x->num_columns = columns;
  x->cameras.assign(reduced.size(), 0.0);
  x->points.assign(rhs.points.size(), 0.0);
  const LinearSolution solution = Solve(reduced.data(), columns, x->cameras.data());
  if (solution.status != LinearSolution::Status::kSuccess) return solution;
  ForPoints([&](int point, const PointBlocks& blocks, const PointAssembler&, int) {
    for (int m = 0; m < columns; ++m) {
      const size_t at = m * num_coordinates + 3 * size_t(point);
      double to[3];
      VectorMatrix3(&rhs.points[at], blocks.inverse, to);
      for (size_t i = 0; i < blocks.blocks.size(); ++i) {
        const double* from = &x->cameras[size_t(m) * n + structure_.offset[blocks.blocks[i]]];
        for (int row = blocks.begin[i]; row < blocks.begin[i + 1]; ++row, ++from) {
          for (int k = 0; k < 3; ++k) to[k] -= blocks.y[3 * size_t(row) + k] * *from;
        }
      }
      std::copy_n(to, 3, &x->points[at]);
    }
  });
  return {};
}

double ReducedSystem::SmallestPivot() const {
  double smallest = std::numeric_limits<double>::infinity();
  if (schur_ == nullptr) return smallest;
  const std::vector<double>& l = schur_->system().values;
  for (int j = 0; j < structure_.num_blocks(); ++j) {
    const int64_t entry = structure_.Entry(j, j);
    for (int k = 0; k < structure_.block_size(j); ++k) {
      const double pivot = l[structure_.ValueIndex(j, entry, k, k)];
      smallest = std::min(smallest, pivot * pivot / diagonal_[structure_.offset[j] + k]);
    }
  }
  return smallest;
}

void ReducedSystem::ForPoints(int num_threads, const PointVisitor& visit) const {
  const int64_t total = problem_.num_observations;
  std::atomic<bool> abandoned{false};
  RunOnThreads(num_threads, [&](int64_t thread) {
    // Points that follow each other, of about as many observations for each thread.
    const auto first_point = [&](int64_t t) {
      if (t >= num_threads) return problem_.num_points;
      const auto& begin = tracks_.begin;
      const auto at = std::lower_bound(begin.begin(), begin.end() - 1, total / num_threads * t);
      return t == 0 ? 0 : static_cast<int>(at - begin.begin());
    };
    PointAssembler assembler(layout_, *evaluator_, tracks_);
    PointBlocks blocks;
    try {
      for (int p = first_point(thread); p < first_point(thread + 1); ++p) {
        if (p % 256 == 0) ThrowIfInterrupted();
        if (abandoned.load(std::memory_order_relaxed)) return;
        if (!layout_.point_is_free(p)) continue;
        assembler.Assemble(p, &blocks);
        visit(p, blocks, assembler, static_cast<int>(thread));
      }
    } catch (...) {
      abandoned.store(true);
      throw;
    }
  });
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
  for (const std::unique_ptr<Factor>& factor : problem_.factors->factors) {
    const ChartedFactor charted(*factor, problem_, layout_);
    FactorRows rows;
    rows.num_rows = charted.num_residuals();
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

bool ReducedSystem::HasBlock(int row, int column) const {
  if (row < column) std::swap(row, column);
  if (structure_.dense) return true;
  const auto first = structure_.row_block.begin() + structure_.column_begin[column];
  const auto last = structure_.row_block.begin() + structure_.column_begin[column + 1];
  return std::binary_search(first, last, row);
}

void ReducedSystem::CopyBlock(const std::vector<double>& values, int row, int column,
                              double* out) const {
  const int rows = structure_.block_size(row), columns = structure_.block_size(column);
  const bool is_stored = row >= column;
  const int j = is_stored ? column : row;
  const int64_t entry = structure_.Entry(j, is_stored ? row : column);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      // Of diagonal blocks the lower triangle counts.
      const bool is_lower = row == column ? r >= c : is_stored;
      *out++ = values[structure_.ValueIndex(j, entry, is_lower ? r : c, is_lower ? c : r)];
    }
  }
}

}  // namespace bundle
