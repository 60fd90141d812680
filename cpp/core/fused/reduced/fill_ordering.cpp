/// Orderings that keep the factor of S sparse, found and judged on its blocks.
///
/// S = L L^T has, below the diagonal of block column j of L, the blocks that S has there and those
/// that earlier columns leave behind. With parent(j) the first block row below the diagonal of
/// column j of L, block (i, j) of L is nonzero exactly if j lies on the path of parents from some k
/// with S_ik nonzero, k < i, up to i (Liu, The role of elimination trees in sparse factorization,
/// 1990). Walking those paths row by row, each until it meets one walked before, visits every block
/// of L once and counts the rows below each diagonal block.
///
/// The blocks of S are full, so the scalar factor is full in the blocks of L: the c-th last scalar
/// column of a block of size m with h rows below has h + c entries, and eliminating it takes
/// (h + c)^2 flops. The counts are those of a scalar analysis (a test holds them against CHOLMOD's)
/// at 1 / m^2 of its cost, so trying several orderings costs little beside one factorisation.

#include "core/fused/reduced/fill_ordering.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

#include "core/fused/reduced/cholmod_session.h"

namespace bundle::fused {
namespace {

/// The blocks left of the diagonal in each row of S, numbered in some order.
struct Rows {
  std::vector<int64_t> begin;
  std::vector<int> column;
};

std::vector<int> Inverse(const std::vector<int>& order) {
  std::vector<int> inverse(order.size());
  for (size_t k = 0; k < order.size(); ++k) inverse[order[k]] = static_cast<int>(k);
  return inverse;
}

Rows PermutedRows(const ReducedStructure& structure, const std::vector<int>& order) {
  const std::vector<int> position = Inverse(order);
  const int num_blocks = structure.num_blocks();
  Rows rows;
  rows.begin.assign(num_blocks + 1, 0);
  const auto for_each = [&](const auto& visit) {
    for (int j = 0; j < num_blocks; ++j) {
      for (int64_t e = structure.column_begin[j] + 1; e < structure.column_begin[j + 1]; ++e) {
        const int a = position[structure.row_block[e]];
        const int b = position[j];
        visit(std::max(a, b), std::min(a, b));
      }
    }
  };
  for_each([&](int row, int) { ++rows.begin[row + 1]; });
  std::partial_sum(rows.begin.begin(), rows.begin.end(), rows.begin.begin());
  rows.column.resize(rows.begin.back());
  std::vector<int64_t> next(rows.begin.begin(), rows.begin.end() - 1);
  for_each([&](int row, int column) { rows.column[next[row]++] = column; });
  return rows;
}

/// parent(j), or -1 for a root. Paths are shortened as they are walked.
std::vector<int> EliminationTree(const Rows& rows) {
  const int num_blocks = static_cast<int>(rows.begin.size()) - 1;
  std::vector<int> parent(num_blocks, -1);
  std::vector<int> ancestor(num_blocks, -1);
  for (int i = 0; i < num_blocks; ++i) {
    for (int64_t e = rows.begin[i]; e < rows.begin[i + 1]; ++e) {
      for (int k = rows.column[e]; k != i;) {
        const int next = ancestor[k];
        ancestor[k] = i;
        if (next < 0) {
          parent[k] = i;
          break;
        }
        k = next;
      }
    }
  }
  return parent;
}

/// Scalar rows below the diagonal block of each block column of L. `size` of the ordered blocks.
std::vector<int64_t> CountRowsBelow(const Rows& rows, const std::vector<int>& parent,
                                    const std::vector<int>& size) {
  std::vector<int64_t> below(size.size(), 0);
  std::vector<int> walked_for(size.size(), -1);
  for (int i = 0; i < static_cast<int>(size.size()); ++i) {
    walked_for[i] = i;
    for (int64_t e = rows.begin[i]; e < rows.begin[i + 1]; ++e) {
      for (int k = rows.column[e]; walked_for[k] != i; k = parent[k]) {
        walked_for[k] = i;
        below[k] += size[i];
      }
    }
  }
  return below;
}

/// Children before parents, subtrees together. The child with most rows comes last, next to its
/// parent, where CHOLMOD can join both into one supernode.
std::vector<int> Postorder(const std::vector<int>& parent, const std::vector<int64_t>& below) {
  const int num_blocks = static_cast<int>(parent.size());
  std::vector<int> first_child(num_blocks, -1), sibling(num_blocks, -1), roots;
  for (int j = 0; j < num_blocks; ++j) {
    const int p = parent[j];
    if (p < 0) {
      roots.push_back(j);
    } else if (first_child[p] < 0 || below[j] >= below[first_child[p]]) {
      sibling[j] = first_child[p];
      first_child[p] = j;
    } else {
      sibling[j] = sibling[first_child[p]];
      sibling[first_child[p]] = j;
    }
  }
  // A parent, then its children from the heaviest on: the reverse of what is wanted.
  std::vector<int> reversed;
  std::vector<int> stack(roots);
  while (!stack.empty()) {
    const int j = stack.back();
    stack.pop_back();
    reversed.push_back(j);
    const size_t first = stack.size();
    for (int child = first_child[j]; child >= 0; child = sibling[child]) stack.push_back(child);
    std::reverse(stack.begin() + static_cast<std::ptrdiff_t>(first), stack.end());
  }
  return {reversed.rbegin(), reversed.rend()};
}

using Order = int (*)(cholmod_sparse*, int64_t*, cholmod_common*);

int Amd(cholmod_sparse* graph, int64_t* order, cholmod_common* common) {
  return cholmod_l_amd(graph, nullptr, 0, order, common);
}

int Metis(cholmod_sparse* graph, int64_t* order, cholmod_common* common) {
  return cholmod_l_metis(graph, nullptr, 0, 0, order, common);
}

/// The graph of the blocks as CHOLMOD takes it: the lower triangle's pattern.
class BlockGraph {
 public:
  explicit BlockGraph(const ReducedStructure& structure)
      : rows_(structure.row_block.begin(), structure.row_block.end()),
        column_begin_(structure.column_begin) {
    graph_.nrow = graph_.ncol = structure.num_blocks();
    graph_.nzmax = rows_.size();
    graph_.p = column_begin_.data();
    graph_.i = rows_.data();
    graph_.stype = -1;
    graph_.itype = CHOLMOD_LONG;
    graph_.xtype = CHOLMOD_PATTERN;
    graph_.dtype = CHOLMOD_DOUBLE;
    graph_.sorted = 1;
    graph_.packed = 1;
  }

  /// Empty if the method failed, which only a lack of memory makes it do.
  std::vector<int> OrderBy(Order method) {
    std::vector<int64_t> order(graph_.ncol);
    if (method(&graph_, order.data(), &session_.common) == 0) return {};
    return {order.begin(), order.end()};
  }

 private:
  CholmodSession session_;
  std::vector<int64_t> rows_;
  std::vector<int64_t> column_begin_;
  cholmod_sparse graph_ = {};
};

/// METIS looks for small separators, of which a nearly full graph has none; CHOLMOD, too, keeps
/// such graphs from it.
constexpr double kDensestForMetis = 0.66;

bool IsNearlyFull(const ReducedStructure& structure) {
  const double n = structure.num_blocks();
  return static_cast<double>(structure.row_block.size()) > kDensestForMetis * n * (n + 1) / 2;
}

}  // namespace

FillOrdering AnalyzeOrdering(const ReducedStructure& structure, const std::string& name,
                             const std::vector<int>& order) {
  const Rows rows = PermutedRows(structure, order);
  const std::vector<int> parent = EliminationTree(rows);
  std::vector<int> size(order.size());
  for (size_t k = 0; k < order.size(); ++k) size[k] = structure.block_size(order[k]);
  const std::vector<int64_t> below = CountRowsBelow(rows, parent, size);

  FillOrdering result;
  result.name = name;
  for (size_t k = 0; k < order.size(); ++k) {
    for (int c = 1; c <= size[k]; ++c) {
      const auto count = static_cast<double>(below[k] + c);
      result.entries += count;
      result.flops += count * count;
    }
  }
  for (const int k : Postorder(parent, below)) result.order.push_back(order[k]);
  return result;
}

FillOrdering FindFillOrdering(const ReducedStructure& structure) {
  std::vector<int> natural(structure.num_blocks());
  std::iota(natural.begin(), natural.end(), 0);
  FillOrdering best = AnalyzeOrdering(structure, "natural", natural);
  if (structure.num_blocks() < 3) return best;

  BlockGraph graph(structure);
  const auto compete = [&](const char* name, Order method) {
    const std::vector<int> order = graph.OrderBy(method);
    if (order.empty()) return;
    FillOrdering candidate = AnalyzeOrdering(structure, name, order);
    if (candidate.flops < best.flops) best = std::move(candidate);
  };
  compete("amd", Amd);
  if (!IsNearlyFull(structure)) compete("metis", Metis);
  return best;
}

}  // namespace bundle::fused
