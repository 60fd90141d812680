#include "core/covariance/reduced_system.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <utility>

#include "core/covariance/eliminated_rows.h"
#include "core/covariance/gauge_sums.h"
#include "core/covariance/point_passes.h"
#include "core/error.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/memory.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"

namespace bundle {
namespace {

/// With fewer unknowns, building the structure of S takes longer than a dense factorisation.
constexpr int kUnknownsWorthALook = 300;

/// A layout in which points that factors join with other unknowns are not eliminated.
ParameterLayout KeepJoinedPoints(const AdjustmentProblem& problem, ParameterLayout layout) {
  FreeParameters free = layout.free();
  bool has_joined = false;
  for (const FactorUnknowns& unknowns : FindFactorUnknowns(problem, layout)) {
    if (LeavesPointsApart(unknowns)) continue;
    for (const int point : unknowns.points) free.point[point] = FreeParameters::kKeptPoint;
    has_joined = has_joined || !unknowns.points.empty();
  }
  if (!has_joined) return layout;
  return {problem, std::move(free)};
}

void RefuseUnsupported(const PreparedSolve& prepared) {
  for (size_t p = 0; p < prepared.track_lengths.size(); ++p) {
    if (prepared.track_lengths[p] <= kMaxTrackLength) continue;
    throw InputError("observation_point: expected at most " + std::to_string(kMaxTrackLength) +
                     " observations of a point, found " +
                     std::to_string(prepared.track_lengths[p]) + " at [" + std::to_string(p) + "]");
  }
}

}  // namespace

ReducedSystem::ReducedSystem(const AdjustmentProblem& problem, const SolveOptions& options,
                             bool sums_gauge)
    : ReducedSystem(problem, options, PrepareSolve(problem, options), sums_gauge) {}

ReducedSystem::ReducedSystem(const AdjustmentProblem& problem, const SolveOptions& options,
                             PreparedSolve prepared, bool sums_gauge)
    : problem_(problem),
      // One sum per thread; rounding depends on the points of each thread.
      num_threads_(options.deterministic ? 1 : EffectiveNumThreads(options.num_threads)),
      warnings_(std::move(prepared.warnings)),
      layout_(KeepJoinedPoints(problem, std::move(prepared.layout))),
      view_(problem) {
  RefuseUnsupported(prepared);
  Order();
  evaluator_ = std::make_unique<ObservationEvaluator>(problem_, layout_, options);
  tracks_ = PointAssembler::FindTracks(problem_, layout_, states());
  OrderPoints();
  if (sums_gauge) {
    gauge_sums_ = std::make_unique<GaugeSums>(problem_, layout_, states(), num_threads_);
  }
  if (num_unknowns() > 0) LinearizeSchur(options);
  FindNullPoints();
  if (!null_points_.empty()) {
    HoldNullDirections();
    if (num_unknowns() > 0) LinearizeSchur(options);
  }
  if (num_unknowns() > 0) FinishLinearization();
}

ReducedSystem::~ReducedSystem() = default;

/// Orders the blocks of the layout for the elimination, and makes the solver.
///
/// Orders by nested dissection, even if another order has less fill-in. The selected inverse goes
/// down the elimination tree, and lower levels amplify the rounding errors of higher ones. An order
/// from one end of a drive to the other makes the tree a path. With 400 images with a lens each,
/// some variances become negative; with 800, they are 1e36 times too large. With nested dissection,
/// the depth of the tree is logarithmic.
void ReducedSystem::Order() {
  if (HasMemoryLimit()) TakeBlasBuffers();
  std::vector<int> sizes;
  for (const CameraBlock& block : layout_.blocks()) sizes.push_back(block.size);
  if (layout_.state_size() < kUnknownsWorthALook) {
    structure_ = DenseStructure(sizes);
    solver_ = MakeDenseSolver(structure_, num_threads_);
    return;
  }
  structure_ = SparseStructure(sizes, FindCoupledBlocks(problem_, layout_, num_threads_));
  const FillOrdering ordering = FindFillOrdering(structure_, "metis");
  layout_.Reorder(ordering.order);
  structure_ = bundle::Reorder(structure_, ordering.order);
  solver_ = MakeSparseSolver(ordering, num_threads_, &structure_);
  RefuseTooMuchMemory(LinearSolverType::kSparseSchur,
                      sizeof(double) * static_cast<double>(structure_.num_values));
}

/// Counting sort by the first block of a point's observations.
void ReducedSystem::OrderPoints() {
  const int num_blocks = static_cast<int>(layout_.blocks().size());
  std::vector<int> first(problem_.num_points, num_blocks);
  for (int64_t i = 0; i < problem_.num_observations; ++i) {
    int& of_point = first[problem_.observation_point[i]];
    const int image = problem_.observation_image[i];
    const int block = layout_.blocks_of(image)[ParameterLayout::kPoseBlock];
    if (block >= 0) of_point = std::min(of_point, block);
  }
  std::vector<int> begin(static_cast<size_t>(num_blocks) + 2, 0);
  for (int p = 0; p < problem_.num_points; ++p) {
    if (layout_.point_is_free(p)) ++begin[first[p] + 1];
  }
  for (int b = 0; b <= num_blocks; ++b) begin[b + 1] += begin[b];
  point_order_.resize(begin.back());
  for (int p = 0; p < problem_.num_points; ++p) {
    if (layout_.point_is_free(p)) point_order_[begin[first[p]]++] = p;
  }
}

void ReducedSystem::LinearizeSchur(const SolveOptions& options) {
  schur_.reset();
  schur_ = std::make_unique<SchurProblem>(view_, layout_, options, structure_, solver_.get(),
                                          /*is_reused=*/true);
  is_finite_ = schur_->Linearize(0).is_finite;
}

/// Completes the last linearisation, in which no point has null directions.
void ReducedSystem::FinishLinearization() {
  if (!is_finite_) {
    throw InputError("problem: expected finite residuals and derivatives of all observations");
  }
  held_ = schur_->active_columns();
  if (std::none_of(held_.begin(), held_.end(), [](uint8_t bit) { return bit != 0; })) held_.clear();
  if (!held_.empty()) evaluator_->Hold(held_);
  AddKeptPoints();
  ReadDiagonal();
}

/// Also replaces rows of constant unknowns by those of the identity.
void ReducedSystem::ReadDiagonal() {
  diagonal_.clear();
  BlockValues& s = values();
  structure_.ForDiagonal([&](int column, int64_t at) {
    if (!held_.empty() && held_[column] != 0) s[at] = 1;
    diagonal_.push_back(s[at]);
  });
}

void ReducedSystem::SetSystem(BlockValues values) {
  if (schur_ == nullptr) return;
  schur_->system().values = std::move(values);
  ReadDiagonal();
}

BlockValues& ReducedSystem::values() {
  return schur_ == nullptr ? no_values_ : schur_->system().values;
}

const BlockValues& ReducedSystem::values() const {
  return schur_ == nullptr ? no_values_ : schur_->system().values;
}

const std::vector<double>& ReducedSystem::rhs() const {
  return schur_ == nullptr ? no_rhs_ : schur_->system().rhs;
}

LinearSolution ReducedSystem::Factorize() {
  if (schur_ == nullptr) return {};
  return solver_->Factorize(&schur_->system(), diagonal_);
}

void ReducedSystem::TakeFactor(const double* lower) {
  std::copy_n(lower, values().size(), values().begin());
}

void ReducedSystem::ExchangeForFactor(BlockValues* factor) {
  if (schur_ == nullptr) return;
  std::swap_ranges(factor->begin(), factor->end(), values().begin());
  solver_->RestoreFactor();
}

LinearSolution ReducedSystem::Solve(const double* rhs, int num_rhs, double* x) {
  if (schur_ == nullptr) return {};
  return solver_->Solve(rhs, num_rhs, 0, x);
}

LinearSolution ReducedSystem::Invert() {
  if (schur_ == nullptr) return {};
  LinearSolution solution = solver_->InvertBlocks();
  structure_.ForDiagonal([&](int column, int64_t at) {
    if (!held_.empty() && held_[column] != 0) values()[at] = 0;
  });
  return solution;
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
  if (solution.status != LinearStatus::kSuccess) return solution;
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

double ReducedSystem::SmallestPivot(int* unknown) const {
  double smallest = std::numeric_limits<double>::infinity();
  if (schur_ == nullptr) return smallest;
  const auto& l = schur_->system().values;
  structure_.ForDiagonal([&](int column, int64_t at) {
    const double share = l[at] * l[at] / diagonal_[column];
    if (!(share < smallest)) return;
    smallest = share;
    *unknown = column;
  });
  return smallest;
}

double ReducedSystem::LargestInflation(int* unknown) const {
  double largest = 0;
  if (schur_ == nullptr) return largest;
  const auto& inverse = schur_->system().values;
  structure_.ForDiagonal([&](int column, int64_t at) {
    if (!held_.empty() && held_[column] != 0) return;
    double inflation = inverse[at] * diagonal_[column];
    if (!(inflation > 0.5)) inflation = std::numeric_limits<double>::infinity();
    if (inflation <= largest) return;
    largest = inflation;
    *unknown = column;
  });
  return largest;
}

void ReducedSystem::ForPoints(int num_threads, const std::vector<int>& points,
                              const PointVisitor& visit) const {
  if (points.empty()) return;
  // Each thread has about the same number of observations.
  std::vector<size_t> first(static_cast<size_t>(num_threads) + 1, points.size());
  first[0] = 0;
  int64_t seen = 0, total = 0;
  for (const int p : points) total += tracks_.begin[p + 1] - tracks_.begin[p];
  int thread_of_next = 1;
  for (size_t k = 0; k < points.size() && thread_of_next < num_threads; ++k) {
    if (seen >= total / num_threads * thread_of_next) first[thread_of_next++] = k;
    seen += tracks_.begin[points[k] + 1] - tracks_.begin[points[k]];
  }
  std::atomic<bool> abandoned{false};
  RunOnThreads(num_threads, [&](int64_t thread) {
    PointAssembler assembler(layout_, *evaluator_, tracks_);
    PointBlocks blocks;
    try {
      for (size_t k = first[thread]; k < first[thread + 1]; ++k) {
        if (k % 256 == 0) ThrowIfInterrupted();
        if (abandoned.load(std::memory_order_relaxed)) return;
        assembler.Assemble(points[k], &blocks);
        if (by_rows_) {
          EliminatedRows(blocks, assembler, point_prior_rows(points[k])).Store(&blocks);
        }
        visit(points[k], blocks, assembler, static_cast<int>(thread));
      }
    } catch (...) {
      abandoned.store(true);
      throw;
    }
  });
}

void ReducedSystem::FindPointCovariances(const FreeGauge* gauge, double* to) const {
  if (schur_ == nullptr) return;
  PointPasses(*schur_, num_threads_).FindCovariances(structure_, values(), gauge, to);
}

void ReducedSystem::FindLeverages(
    bool is_without, const double* adjoint, double* covariances,
    const std::function<void(int64_t, const ObservationLeverage&)>& visit) const {
  if (schur_ == nullptr) return;
  PointPasses(*schur_, num_threads_)
      .FindLeverages(structure_, is_without ? nullptr : &values(), adjoint, covariances, visit);
}

void ReducedSystem::FindMovements(
    const double* by_unknown, int num_quads, const std::vector<uint8_t>& is_wanted,
    const std::function<void(int, const double*, const double*, int)>& visit) const {
  if (schur_ == nullptr) return;
  PointPasses(*schur_, num_threads_).FindMovements(by_unknown, num_quads, is_wanted, visit);
}

bool ReducedSystem::HasBlock(int row, int column) const {
  if (row < column) std::swap(row, column);
  const auto first = structure_.row_block.begin() + structure_.column_begin[column];
  const auto last = structure_.row_block.begin() + structure_.column_begin[column + 1];
  return std::binary_search(first, last, row);
}

}  // namespace bundle
