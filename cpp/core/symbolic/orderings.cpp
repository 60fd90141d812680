#include "core/symbolic/orderings.h"

/// Elimination orders by CHOLMOD (AMD, COLAMD, METIS, NESDIS), and by minimum fill.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <tuple>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

constexpr std::pair<const char*, OrderingMethod> kNames[] = {
    {"natural", OrderingMethod::kNatural},
    {"reverse", OrderingMethod::kReverse},
    {"amd", OrderingMethod::kAmd},
    {"colamd", OrderingMethod::kColamd},
    {"metis", OrderingMethod::kMetis},
    {"nesdis", OrderingMethod::kNesdis},
    {"minimum_fill", OrderingMethod::kMinimumFill}};

/// A CHOLMOD pattern stored in std::vectors. `symmetric`: the lower triangle of a square matrix.
class Graph {
 public:
  Graph(int64_t num_rows, std::vector<int64_t> column_begin, std::vector<int64_t> rows,
        bool symmetric)
      : column_begin_(std::move(column_begin)), rows_(std::move(rows)) {
    sparse.nrow = num_rows;
    sparse.ncol = column_begin_.size() - 1;
    sparse.nzmax = rows_.size();
    sparse.p = column_begin_.data();
    sparse.i = rows_.data();
    sparse.stype = symmetric ? -1 : 0;
    sparse.itype = CHOLMOD_LONG;
    sparse.xtype = CHOLMOD_PATTERN;
    sparse.dtype = CHOLMOD_DOUBLE;
    sparse.sorted = 1;
    sparse.packed = 1;
  }
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;

  cholmod_sparse sparse = {};

 private:
  std::vector<int64_t> column_begin_;
  std::vector<int64_t> rows_;
};

Graph Adjacency(const BlockPatternView& pattern) {
  return Graph(pattern.num_blocks,
               {pattern.column_begin, pattern.column_begin + pattern.num_blocks + 1},
               {pattern.row, pattern.row + pattern.num_entries()}, /*symmetric=*/true);
}

/// Transposed, as CHOLMOD's COLAMD expects a matrix: a column for each edge, with its two vertices.
/// A vertex without edges is an empty row, which COLAMD puts last.
Graph Incidence(const BlockPatternView& pattern) {
  std::vector<int64_t> column_begin(pattern.num_edges() + 1), rows;
  for (size_t e = 0; e < column_begin.size(); ++e) column_begin[e] = 2 * static_cast<int64_t>(e);
  rows.reserve(2 * pattern.num_edges());
  for (int j = 0; j < pattern.num_blocks; ++j) {
    for (int64_t e = pattern.column_begin[j] + 1; e < pattern.column_begin[j + 1]; ++e) {
      rows.push_back(j);
      rows.push_back(pattern.row[e]);
    }
  }
  return Graph(pattern.num_blocks, std::move(column_begin), std::move(rows), /*symmetric=*/false);
}

/// Calls a method with CHOLMOD's arguments: method(graph, order, common) returns 0 on failure.
template <typename Method>
std::vector<int> OrderBy(Graph graph, const Method& method) {
  std::vector<int64_t> order(graph.sparse.nrow);
  CholmodSession session;
  if (method(&graph.sparse, order.data(), &session.common) == 0) return {};
  return {order.begin(), order.end()};
}

std::vector<int> Amd(const BlockPatternView& pattern) {
  return OrderBy(Adjacency(pattern), [](auto* graph, int64_t* order, cholmod_common* common) {
    return cholmod_l_amd(graph, nullptr, 0, order, common);
  });
}

std::vector<int> Colamd(const BlockPatternView& pattern) {
  return OrderBy(Incidence(pattern), [](auto* graph, int64_t* order, cholmod_common* common) {
    return cholmod_l_colamd(graph, nullptr, 0, /*postorder=*/0, order, common);
  });
}

std::vector<int> Metis(const BlockPatternView& pattern) {
  return OrderBy(Adjacency(pattern), [](auto* graph, int64_t* order, cholmod_common* common) {
    return cholmod_l_metis(graph, nullptr, 0, /*postorder=*/0, order, common);
  });
}

std::vector<int> Nesdis(const BlockPatternView& pattern) {
  return OrderBy(Adjacency(pattern), [&](auto* graph, int64_t* order, cholmod_common* common) {
    std::vector<int64_t> parent(pattern.num_blocks), member(pattern.num_blocks);
    return cholmod_l_nested_dissection(graph, nullptr, 0, order, parent.data(), member.data(),
                                       common) >= 0;
  });
}

int64_t WordsOfRow(int num_blocks) { return (int64_t{num_blocks} + 63) / 64; }

/// Elimination by minimum fill (Tinney and Walker, 1967), on a graph of bits. The fill-in that the
/// elimination of a block would add, the pairs of its neighbours without an edge, is kept up to
/// date. It changes at an edge that is added, and at its common neighbours, and when a neighbour is
/// eliminated. So the time is that of counting it once, and of the fill-in.
class FillElimination {
 public:
  explicit FillElimination(const BlockPatternView& pattern)
      : num_blocks_(pattern.num_blocks),
        words_(WordsOfRow(num_blocks_)),
        bits_(num_blocks_ * words_),
        degree_(num_blocks_),
        fill_(num_blocks_),
        is_left_(num_blocks_, true) {
    const auto for_edges = [&](const auto& visit) {
      for (int j = 0; j < num_blocks_; ++j) {
        for (int64_t e = pattern.column_begin[j] + 1; e < pattern.column_begin[j + 1]; ++e) {
          visit(j, pattern.row[e]);
        }
      }
    };
    for_edges([&](int a, int b) { Join(a, b); });
    for (int j = 0; j < num_blocks_; ++j) fill_[j] = int64_t{degree_[j]} * (degree_[j] - 1) / 2;
    // An edge between neighbours of a block is counted from its other two.
    std::vector<int64_t> twice_edges(num_blocks_, 0);
    for_edges([&](int a, int b) {
      const int64_t common = CountCommon(a, b);
      twice_edges[a] += common;
      twice_edges[b] += common;
    });
    for (int j = 0; j < num_blocks_; ++j) fill_[j] -= twice_edges[j] / 2;
  }

  std::vector<int> Order() {
    std::vector<int> order;
    for (int k = 0; k < num_blocks_; ++k) {
      int best = -1;
      for (int j = 0; j < num_blocks_; ++j) {
        if (!is_left_[j]) continue;
        if (best < 0 || std::tie(fill_[j], degree_[j]) < std::tie(fill_[best], degree_[best])) {
          best = j;
        }
      }
      Eliminate(best);
      order.push_back(best);
    }
    return order;
  }

 private:
  uint64_t* Row(int block) { return bits_.data() + block * words_; }

  /// Calls visit(j) for the bits that word(i) has in its words i.
  template <typename Word, typename Visit>
  void ForBits(const Word& word, const Visit& visit) {
    for (int64_t i = 0; i < words_; ++i) {
      for (uint64_t left = word(i); left != 0; left &= left - 1) {
        visit(static_cast<int>(64 * i) + __builtin_ctzll(left));
      }
    }
  }

  int CountCommon(int a, int b) {
    const uint64_t *const of_a = Row(a), *const of_b = Row(b);
    int count = 0;
    for (int64_t i = 0; i < words_; ++i) count += __builtin_popcountll(of_a[i] & of_b[i]);
    return count;
  }

  void Join(int a, int b) {
    Row(a)[b / 64] |= uint64_t{1} << (b % 64);
    Row(b)[a / 64] |= uint64_t{1} << (a % 64);
    ++degree_[a];
    ++degree_[b];
  }

  void AddEdge(int a, int b) {
    const uint64_t *const of_a = Row(a), *const of_b = Row(b);
    int common = 0;
    ForBits([&](int64_t i) { return of_a[i] & of_b[i]; },
            [&](int j) {
              --fill_[j];
              ++common;
            });
    fill_[a] += degree_[a] - common;
    fill_[b] += degree_[b] - common;
    Join(a, b);
  }

  /// Joins all neighbours of a block and removes it. A neighbour loses its pairs with the block:
  /// those that are no neighbours of the block.
  void Eliminate(int block) {
    const uint64_t* const of_block = Row(block);
    const auto row = [&](int64_t i) { return of_block[i]; };
    ForBits(row, [&](int a) {
      const uint64_t* const of_a = Row(a);
      ForBits([&](int64_t i) { return of_block[i] & ~of_a[i]; },
              [&](int b) {
                if (b != a) AddEdge(a, b);
              });
    });
    ForBits(row, [&](int a) {
      fill_[a] -= degree_[a] - degree_[block];
      Row(a)[block / 64] &= ~(uint64_t{1} << (block % 64));
      --degree_[a];
    });
    is_left_[block] = false;
  }

  const int num_blocks_;
  const int64_t words_;
  std::vector<uint64_t> bits_;  ///< neighbours of each block that are left
  std::vector<int> degree_;
  std::vector<int64_t> fill_;
  std::vector<bool> is_left_;
};

std::vector<int> Natural(int num_blocks) {
  std::vector<int> order(num_blocks);
  std::iota(order.begin(), order.end(), 0);
  return order;
}

/// Graphs with more blocks than this are sorted before minimum degree is applied.
constexpr int kBlocksWorthSorting = 20000;

/// Blocks by their number of neighbours, then by the first and the last of these.
///
/// Minimum degree eliminates blocks of equal degree in the order of their numbers. The points of a
/// reconstruction are in any order. Each leaves an element in the lists of its cameras until an
/// element with all of its cameras absorbs it. If points of the same cameras are consecutive, the
/// lists stay short: AMD took 7 s instead of 34 s for 5000 cameras and 1,000,000 points of a
/// street, and COLAMD half its time, with the same fill-in.
std::vector<int> SortByNeighbours(const BlockPatternView& pattern) {
  const int n = pattern.num_blocks;
  std::vector<int> degree(n, 0), first(n, n), last(n, -1), blocks = Natural(n);
  const auto add = [&](int block, int neighbour) {
    ++degree[block];
    first[block] = std::min(first[block], neighbour);
    last[block] = std::max(last[block], neighbour);
  };
  for (int j = 0; j < n; ++j) {
    for (int64_t e = pattern.column_begin[j] + 1; e < pattern.column_begin[j + 1]; ++e) {
      add(j, pattern.row[e]);
      add(pattern.row[e], j);
    }
  }
  std::sort(blocks.begin(), blocks.end(), [&](int a, int b) {
    return std::tie(degree[a], first[a], last[a], a) < std::tie(degree[b], first[b], last[b], b);
  });
  return blocks;
}

using FindByDegree = std::vector<int> (*)(const BlockPatternView&);

std::vector<int> OrderByDegree(const BlockPatternView& pattern, FindByDegree method) {
  if (pattern.num_blocks <= kBlocksWorthSorting) return method(pattern);
  const std::vector<int> blocks = SortByNeighbours(pattern);
  std::vector<int> sizes(blocks.size(), 1);  // not used by any method
  std::vector<int> order = method(PatternOfRows(PermuteRows(pattern, blocks), std::move(sizes)));
  for (int& block : order) block = blocks[block];
  return order;
}

}  // namespace

OrderingMethod OrderingFromName(const std::string& name) {
  std::string known;
  for (const auto& [candidate, method] : kNames) {
    if (name == candidate) return method;
    known += std::string(known.empty() ? "" : ", ") + candidate;
  }
  throw InputError("ordering: expected one of " + known + ", found " + name);
}

std::string OrderingName(OrderingMethod method) {
  for (const auto& [name, candidate] : kNames) {
    if (candidate == method) return name;
  }
  return "";
}

std::vector<int> FindOrder(const BlockPatternView& pattern, OrderingMethod method) {
  std::vector<int> natural = Natural(pattern.num_blocks);
  if (pattern.num_edges() == 0 && method != OrderingMethod::kReverse) return natural;
  switch (method) {
    case OrderingMethod::kNatural:
      return natural;
    case OrderingMethod::kReverse:
      return {natural.rbegin(), natural.rend()};
    case OrderingMethod::kAmd:
      return OrderByDegree(pattern, &Amd);
    case OrderingMethod::kColamd:
      return OrderByDegree(pattern, &Colamd);
    case OrderingMethod::kMetis:
      return IsNearlyFull(pattern) ? Amd(pattern) : Metis(pattern);
    case OrderingMethod::kNesdis:
      return IsNearlyFull(pattern) ? Amd(pattern) : Nesdis(pattern);
    case OrderingMethod::kMinimumFill:
      return IsFastByFill(pattern) ? FillElimination(pattern).Order()
                                   : OrderByDegree(pattern, &Amd);
  }
  return natural;
}

bool IsFastByFill(const BlockPatternView& pattern) {
  constexpr int64_t kMostWords = 1 << 20;  // 4 ns each
  const int64_t n = pattern.num_blocks;
  return n * n / 4 + pattern.num_edges() * WordsOfRow(pattern.num_blocks) <= kMostWords;
}

bool IsNearlyFull(const BlockPatternView& pattern) {
  constexpr double kDensest = 0.66;
  const double n = pattern.num_blocks;
  return static_cast<double>(pattern.num_entries()) > kDensest * n * (n + 1) / 2;
}

void CheckOrder(const std::vector<int>& order, int num_blocks) {
  if (static_cast<int>(order.size()) != num_blocks) {
    throw InputError("order: expected " + std::to_string(num_blocks) + " blocks, found " +
                     std::to_string(order.size()));
  }
  std::vector<bool> seen(num_blocks, false);
  for (const int block : order) {
    if (block < 0 || block >= num_blocks || seen[block]) {
      throw InputError("order: expected each of the blocks 0 to " + std::to_string(num_blocks - 1) +
                       " once, found " + std::to_string(block) +
                       (block < 0 || block >= num_blocks ? "" : " twice"));
    }
    seen[block] = true;
  }
}

}  // namespace bundle
