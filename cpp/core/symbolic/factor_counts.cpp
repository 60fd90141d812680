#include "core/symbolic/factor_counts.h"

/// The structure of L without L (Liu, The role of elimination trees in sparse factorization, 1990;
/// Gilbert, Ng and Peyton, An efficient algorithm to compute row and column counts for sparse
/// Cholesky factorization, 1994).
///
/// Let parent(j) be the first block row below the diagonal of block column j of L; the parents form
/// the elimination tree. Block (i, j) of L is nonzero exactly if j lies on the path of parents from
/// some k with A_ik nonzero, k < i, up to i: these paths are the row's subtree, with root i. The
/// rows in column j are those whose subtrees contain j. Their number follows from differences along
/// the tree, so that no path has to be traversed. In postorder, a subtree is an interval. Each
/// subtree of a row i adds its weight w_i at its leaves, and subtracts it where the paths from two
/// neighbouring leaves meet and at the parent of i. The sum over the tree below j is then the
/// weight of the rows in column j. The weight is 1 for counts of blocks and the size of the block
/// for counts of scalar rows. The time is nearly that of reading the matrix, for any fill-in of L.
///
/// The blocks of the matrix are full, so the scalar factor is full in the blocks of L: the c-th
/// last scalar column of a block of size m with h rows below has h + c - 1 entries below its
/// diagonal. The counts equal those of a scalar analysis (a test compares them with CHOLMOD's) at 1
/// / m^2 of its cost.

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>

namespace bundle {
namespace {

/// parent(j), or -1 for a root. Paths are compressed during the traversal.
std::vector<int> EliminationTree(const BlockRows& rows) {
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

/// Postorder: children before parents, subtrees contiguous. The child with the largest weight comes
/// last, next to its parent, where CHOLMOD can join both into one supernode.
std::vector<int> Postorder(const std::vector<int>& parent, const std::vector<int64_t>& weight) {
  const int num_blocks = static_cast<int>(parent.size());
  std::vector<int> first_child(num_blocks, -1), sibling(num_blocks, -1), roots;
  for (int j = 0; j < num_blocks; ++j) {
    const int p = parent[j];
    if (p < 0) {
      roots.push_back(j);
    } else if (first_child[p] < 0 || weight[j] >= weight[first_child[p]]) {
      sibling[j] = first_child[p];
      first_child[p] = j;
    } else {
      sibling[j] = sibling[first_child[p]];
      sibling[first_child[p]] = j;
    }
  }
  // A parent, then its children, heaviest first: the reverse of the required order.
  std::vector<int> reversed;
  reversed.reserve(num_blocks);
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

/// Finds the leaves of all rows' subtrees; blocks must be queried in postorder.
class RowSubtrees {
 public:
  RowSubtrees(const std::vector<int>& parent, const std::vector<int>& postorder)
      : first_(parent.size(), -1),
        last_first_(parent.size(), -1),
        last_leaf_(parent.size(), -1),
        ancestor_(parent.size()) {
    std::iota(ancestor_.begin(), ancestor_.end(), 0);
    for (size_t k = 0; k < postorder.size(); ++k) {
      for (int j = postorder[k]; j >= 0 && first_[j] < 0; j = parent[j]) {
        first_[j] = static_cast<int>(k);
        if (j == postorder[k]) leaves_.push_back(j);
      }
    }
  }

  /// The leaves of the elimination tree itself.
  const std::vector<int>& leaves() const { return leaves_; }

  /// True if j, a block of row i's subtree, is a leaf of it: no block below j was queried for i.
  /// `meeting`: where its path meets that of the previous leaf; -1 if it is the first.
  bool IsLeaf(int i, int j, int* meeting) {
    if (first_[j] <= last_first_[i]) return false;
    last_first_[i] = first_[j];
    *meeting = last_leaf_[i] < 0 ? -1 : Root(last_leaf_[i]);
    last_leaf_[i] = j;
    return true;
  }

  /// Marks j as complete: all blocks below it have been queried.
  void Finish(int j, int parent) {
    if (parent >= 0) ancestor_[j] = parent;
  }

 private:
  /// Root of the completed part of the tree that contains j. Compresses paths.
  int Root(int j) {
    int root = j;
    while (ancestor_[root] != root) root = ancestor_[root];
    while (j != root) j = std::exchange(ancestor_[j], root);
    return root;
  }

  std::vector<int> first_;       ///< place in postorder of the first block of the tree below
  std::vector<int> last_first_;  ///< per row: first_ of its last leaf
  std::vector<int> last_leaf_;   ///< per row: its last leaf
  std::vector<int> ancestor_;
  std::vector<int> leaves_;
};

/// Counts of blocks and of scalar rows.
struct Weight {
  int64_t blocks = 0;
  int64_t rows = 0;
  void operator+=(const Weight& other) {
    blocks += other.blocks;
    rows += other.rows;
  }
  void operator-=(const Weight& other) {
    blocks -= other.blocks;
    rows -= other.rows;
  }
};

/// Counts of each block column of L, with the diagonal, for a matrix in the order of its
/// elimination tree.
std::vector<Weight> CountColumns(const BlockPatternView& matrix, const std::vector<int>& parent,
                                 const std::vector<int>& postorder) {
  std::vector<Weight> count(parent.size());
  const auto weight = [&](int i) { return Weight{1, matrix.size[i]}; };
  RowSubtrees subtrees(parent, postorder);
  for (const int leaf : subtrees.leaves()) count[leaf] += weight(leaf);
  for (const int j : postorder) {
    if (parent[j] >= 0) count[parent[j]] -= weight(j);
    for (int64_t e = matrix.column_begin[j] + 1; e < matrix.column_begin[j + 1]; ++e) {
      const int i = matrix.row[e];
      int meeting = -1;
      if (!subtrees.IsLeaf(i, j, &meeting)) continue;
      count[j] += weight(i);
      if (meeting >= 0) count[meeting] -= weight(i);
    }
    subtrees.Finish(j, parent[j]);
  }
  for (const int j : postorder) {
    if (parent[j] >= 0) count[parent[j]] += count[j];
  }
  return count;
}

int TreeHeight(const std::vector<int>& parent) {
  std::vector<int> height(parent.size(), 1);
  int tallest = 0;
  for (size_t j = 0; j < parent.size(); ++j) {  // a parent comes after its children
    tallest = std::max(tallest, height[j]);
    if (parent[j] >= 0) height[parent[j]] = std::max(height[parent[j]], height[j] + 1);
  }
  return tallest;
}

/// Adds a block of `size` scalar columns with `below` rows under it.
void AddColumns(double size, double below, FactorCounts* counts) {
  const double last = size - 1;
  const double sum = size * below + size * last / 2;  // of c = below ... below + size - 1
  const double squares =
      size * below * below + below * size * last + last * size * (2 * size - 1) / 6;
  counts->entries += sum + size;
  counts->flops += squares + 3 * sum;
  counts->cholmod_flops += squares + 2 * sum + size;
}

}  // namespace

FactorCounts CountFactor(const BlockPatternView& pattern, const std::vector<int>& order) {
  const int n = pattern.num_blocks;
  std::vector<int> size(n);
  for (int k = 0; k < n; ++k) size[k] = pattern.size[order[k]];
  FactorCounts counts;
  std::vector<Weight> columns;
  {
    const BlockRows rows = PermuteRows(pattern, order);
    counts.parent = EliminationTree(rows);
    const BlockPattern matrix = PatternOfRows(rows, size);
    columns =
        CountColumns(matrix, counts.parent, Postorder(counts.parent, std::vector<int64_t>(n, 0)));
  }
  counts.rows_below.resize(n);
  counts.blocks_below.resize(n);
  for (int k = 0; k < n; ++k) {
    counts.rows_below[k] = columns[k].rows - size[k];
    counts.blocks_below[k] = columns[k].blocks - 1;
    counts.block_entries += columns[k].blocks;
    AddColumns(size[k], static_cast<double>(counts.rows_below[k]), &counts);
  }
  counts.fill_edges = counts.block_entries - pattern.num_entries();
  counts.tree_height = TreeHeight(counts.parent);
  counts.postorder = Postorder(counts.parent, counts.rows_below);
  return counts;
}

double DenseFactorEntries(double n) { return n * (n + 1) / 2; }

double DenseFactorFlops(double n) { return n * (n - 1) * (2 * n - 1) / 6 + 3 * n * (n - 1) / 2; }

}  // namespace bundle
