#include "core/covariance/eliminated_part.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "core/error.h"
#include "core/linear/block_structure.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/symmetric_product.h"
#include "core/prepare/memory.h"

namespace bundle {
namespace {

/// Threshold for L_jj^2 over the diagonal of J^T J. A smaller pivot is too close to rounding
/// errors.
constexpr double kWeakPivot = 1e-9;
constexpr double kDamping = 1e-12;
constexpr double kMaxDamping = 1e-6;
constexpr int kMaxRepetitions = 20;
/// With fewer unknowns, a dense factorisation is faster.
constexpr int kDenseBelow = 300;

constexpr LinearStatus kSuccess = LinearStatus::kSuccess;

}  // namespace

void RefuseBeyondMemory(double numbers, const std::string& what) {
  const double bytes = sizeof(double) * numbers, available = AvailableMemoryFor(bytes);
  if (FitsIntoMemory(bytes, available)) return;
  throw InputError("rest: marginal needs " + FormatBytes(bytes) + " for " + what +
                   "; this machine has " + FormatBytes(available) +
                   " free; name fewer images, or use fixed");
}

EliminatedPart::EliminatedPart(const ReducedSystem& whole, const std::vector<double>& diagonal)
    : whole_(whole), diagonal_(diagonal), threads_(whole.num_threads()) {}

void EliminatedPart::Take(const std::vector<uint8_t>& is_kept, std::vector<int>* place) {
  const BlockStructure& s = whole_.structure();
  std::vector<int> sizes, part_of(s.num_blocks(), -1);
  for (int b = 0; b < s.num_blocks(); ++b) {
    int size = 0;
    for (int u = s.offset[b]; u < s.offset[b + 1]; ++u) size += is_kept[u] == 0 ? 1 : 0;
    if (size == 0) continue;
    part_of[b] = static_cast<int>(sizes.size());
    sizes.push_back(size);
  }
  for (const int size : sizes) num_unknowns_ += size;
  std::vector<int> order(sizes.size());
  for (size_t k = 0; k < order.size(); ++k) order[k] = static_cast<int>(k);
  if (num_unknowns_ < kDenseBelow) {
    structure_ = DenseStructure(sizes);
    solver_ = MakeDenseSolver(structure_, threads_);
  } else {
    std::vector<std::vector<int>> columns(sizes.size());
    for (int j = 0; j < s.num_blocks(); ++j) {
      for (int64_t e = s.column_begin[j]; part_of[j] >= 0 && e < s.column_begin[j + 1]; ++e) {
        const int i = part_of[s.row_block[e]];
        if (i >= 0) columns[part_of[j]].push_back(i);
      }
    }
    structure_ = SparseStructure(sizes, columns);
    const FillOrdering ordering = FindFillOrdering(structure_);
    order = ordering.order;
    structure_ = bundle::Reorder(structure_, order);
    solver_ = MakeSparseSolver(ordering, threads_, &structure_);
  }
  RefuseBeyondMemory(2 * static_cast<double>(structure_.num_values), "its factor");
  std::vector<int> position(order.size());
  for (size_t k = 0; k < order.size(); ++k) position[order[k]] = static_cast<int>(k);
  place_.assign(s.num_columns(), -1);
  block_.assign(s.num_blocks(), -1);
  for (int b = 0; b < s.num_blocks(); ++b) {
    if (part_of[b] < 0) continue;
    block_[b] = position[part_of[b]];
    int next = structure_.offset[block_[b]];
    for (int u = s.offset[b]; u < s.offset[b + 1]; ++u) {
      if (is_kept[u] == 0) place_[u] = next++;
    }
  }
  *place = place_;
  own_diagonal_.resize(num_unknowns_);
  for (size_t u = 0; u < place_.size(); ++u) {
    if (place_[u] >= 0) own_diagonal_[place_[u]] = diagonal_[u];
  }
}

void EliminatedPart::Factorize() {
  if (num_unknowns_ == 0) return;
  const std::vector<double> none(num_unknowns_, 0.0);
  Fill(none, &system_.values);
  if (solver_->Factorize(&system_, own_diagonal_).status == kSuccess &&
      SmallestPivot() > kWeakPivot) {
    return;
  }
  is_regular_ = false;
  Fill(none, &values_);
  product_ = std::make_unique<SymmetricProduct>(structure_, threads_);
  LinearSolution solution;
  for (double damping = kDamping; damping <= kMaxDamping; damping *= 100) {
    std::vector<double> added(num_unknowns_);
    for (int i = 0; i < num_unknowns_; ++i) {
      added[i] = own_diagonal_[i] > 0 ? damping * own_diagonal_[i] : 1.0;
    }
    Fill(added, &system_.values);
    solution = solver_->Factorize(&system_, own_diagonal_);
    if (solution.status == kSuccess) return;
  }
  throw InputError("rest: expected finite normal equations of what is marginalised: " +
                   solution.message);
}

void EliminatedPart::Solve(const std::vector<double>& b, int num_columns, std::vector<double>* x) {
  x->assign(b.size(), 0.0);
  if (num_unknowns_ == 0) return;
  SolveOnce(b, num_columns, x);
  if (is_regular_) return;
  std::vector<double> rest, step, product(num_unknowns_);
  double before = Residual(b, num_columns, *x, &product, &rest);
  for (int k = 0; k < kMaxRepetitions && before > 0; ++k) {
    SolveOnce(rest, num_columns, &step);
    std::vector<double> next = *x;
    for (size_t i = 0; i < next.size(); ++i) next[i] += step[i];
    const double after = Residual(b, num_columns, next, &product, &rest);
    if (!(after < before)) return;
    *x = std::move(next);
    if (after > 0.5 * before) return;
    before = after;
  }
}

void EliminatedPart::Fill(const std::vector<double>& added, BlockValues* values) const {
  values->assign(structure_.num_values, 0.0);
  const BlockStructure& s = whole_.structure();
  for (int column = 0; column < s.num_blocks(); ++column) {
    for (int64_t e = s.column_begin[column]; e < s.column_begin[column + 1]; ++e) {
      const int row = s.row_block[e], a = block_[row], b = block_[column];
      if (a < 0 || b < 0) continue;
      const int to = std::min(a, b), below = std::max(a, b);
      const int64_t entry = structure_.Entry(to, below);
      for (int c = 0; c < s.block_size(column); ++c) {
        const int j = place_[s.offset[column] + c];
        for (int r = row == column ? c : 0; j >= 0 && r < s.block_size(row); ++r) {
          const int i = place_[s.offset[row] + r];
          if (i < 0) continue;
          (*values)[structure_.ValueIndex(to, entry, std::max(i, j) - structure_.offset[below],
                                          std::min(i, j) - structure_.offset[to])] =
              whole_.values()[s.ValueIndex(column, e, r, c)] + (i == j ? added[i] : 0.0);
        }
      }
    }
  }
}

double EliminatedPart::SmallestPivot() const {
  double smallest = 1;
  structure_.ForDiagonal([&](int column, int64_t at) {
    const double pivot = system_.values[at];
    smallest = std::min(smallest, pivot * pivot / own_diagonal_[column]);
  });
  return smallest;
}

void EliminatedPart::SolveOnce(const std::vector<double>& b, int num_columns,
                               std::vector<double>* x) {
  x->resize(b.size());
  const LinearSolution solution = solver_->Solve(b.data(), num_columns, 0, x->data());
  if (solution.status == kSuccess) return;
  throw InputError("rest: expected finite normal equations of what is marginalised: " +
                   solution.message);
}

double EliminatedPart::Residual(const std::vector<double>& b, int num_columns,
                                const std::vector<double>& x, std::vector<double>* product,
                                std::vector<double>* rest) {
  rest->resize(b.size());
  double worst = 0;
  for (int m = 0; m < num_columns; ++m) {
    const size_t at = static_cast<size_t>(m) * num_unknowns_;
    product_->Multiply(values_, &x[at], product->data());
    double of_rest = 0, of_b = 0;
    for (int i = 0; i < num_unknowns_; ++i) {
      (*rest)[at + i] = b[at + i] - (*product)[i];
      if (!(own_diagonal_[i] > 0)) continue;
      of_rest += (*rest)[at + i] * (*rest)[at + i] / own_diagonal_[i];
      of_b += b[at + i] * b[at + i] / own_diagonal_[i];
    }
    if (of_b > 0) worst = std::max(worst, std::sqrt(of_rest / of_b));
  }
  return worst;
}

}  // namespace bundle
