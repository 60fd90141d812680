#include "core/linear/edge_system.h"

/// Blocks are stored where the supernodal factorisation needs them, in AMD's order.

#include <algorithm>
#include <utility>

#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"

namespace bundle {
std::vector<double> SolveEdgeSystem(const EdgeSystem& system) {
  const int d = system.block_size;
  const int64_t n = system.num_nodes;
  if (n == 0) return {};
  std::vector<std::pair<int, int>> pairs;
  for (int64_t e = 0; e < system.num_edges; ++e) {
    pairs.emplace_back(system.edges[2 * e], system.edges[2 * e + 1]);
  }
  const BlockStructure natural = StructureOfPairs(static_cast<int>(n), d, pairs);
  const FillOrdering ordering = FindFillOrdering(natural, "amd");
  BlockStructure structure = Reorder(natural, ordering.order);
  const auto solver = MakeSparseSolver(ordering, 1, &structure);
  std::vector<int> place(n);
  for (int64_t k = 0; k < n; ++k) place[ordering.order[k]] = static_cast<int>(k);

  BlockSystem blocks;
  blocks.values.assign(structure.num_values, 0.0);
  blocks.rhs.resize(n * d);
  for (int64_t i = 0; i < n; ++i) {
    const int k = place[i];
    const int64_t entry = structure.column_begin[k];
    for (int c = 0; c < d; ++c) {
      blocks.rhs[int64_t{k} * d + c] = system.rhs[i * d + c];
      for (int r = c; r < d; ++r) {
        blocks.values[structure.ValueIndex(k, entry, r, c)] += system.diagonal[(i * d + r) * d + c];
      }
    }
  }
  for (int64_t e = 0; e < system.num_edges; ++e) {
    const int first = place[system.edges[2 * e]], second = place[system.edges[2 * e + 1]];
    const int column = std::min(first, second);
    const int64_t entry = structure.Entry(column, std::max(first, second));
    const double* const block = system.between + e * d * d;
    for (int c = 0; c < d; ++c) {
      for (int r = 0; r < d; ++r) {
        blocks.values[structure.ValueIndex(column, entry, r, c)] +=
            first > second ? block[r * d + c] : block[c * d + r];
      }
    }
  }
  const std::vector<double> scale(n * d, 1.0);
  std::vector<double> permuted(n * d);
  const LinearSolution solution = solver->Solve(&blocks, scale, 0, permuted.data());
  if (solution.status != LinearStatus::kSuccess) return {};
  std::vector<double> x(n * d);
  for (int64_t i = 0; i < n; ++i) {
    std::copy_n(permuted.data() + int64_t{place[i]} * d, d, x.data() + i * d);
  }
  return x;
}

}  // namespace bundle
