#pragma once

#include <algorithm>
#include <numeric>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

using Edge = std::pair<int, int>;

inline BlockPattern PatternOfEdges(std::vector<int> sizes, const std::vector<Edge>& edges) {
  std::vector<std::set<int>> rows(sizes.size());
  for (const auto& [a, b] : edges) rows[std::min(a, b)].insert(std::max(a, b));
  std::vector<std::vector<int>> columns(sizes.size());
  for (size_t j = 0; j < sizes.size(); ++j) {
    columns[j].push_back(static_cast<int>(j));
    columns[j].insert(columns[j].end(), rows[j].begin(), rows[j].end());
  }
  return MakeBlockPattern(std::move(sizes), columns);
}

/// Any two blocks meet with the chance of `density`.
inline BlockPattern RandomPattern(int num_blocks, int max_size, double density, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<int> sizes(num_blocks);
  for (int& size : sizes) size = std::uniform_int_distribution<int>(1, max_size)(random);
  std::vector<Edge> edges;
  for (int j = 0; j < num_blocks; ++j) {
    for (int i = j + 1; i < num_blocks; ++i) {
      if (std::uniform_real_distribution<double>()(random) < density) edges.emplace_back(i, j);
    }
  }
  return PatternOfEdges(std::move(sizes), edges);
}

/// side x side vertices, row by row.
inline BlockPattern Grid(int side) {
  std::vector<Edge> edges;
  for (int j = 0; j < side * side; ++j) {
    if (j % side < side - 1) edges.emplace_back(j, j + 1);
    if (j + side < side * side) edges.emplace_back(j, j + side);
  }
  return PatternOfEdges(std::vector<int>(side * side, 1), edges);
}

inline std::vector<int> ShuffledOrder(int num_blocks, unsigned seed) {
  std::vector<int> order(num_blocks);
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), std::mt19937(seed));
  return order;
}

/// True if every tree is the stretch of numbers that ends in its root.
inline bool IsPostordered(const std::vector<int>& parent) {
  const int n = static_cast<int>(parent.size());
  std::vector<int> first(n), size(n, 1);
  std::iota(first.begin(), first.end(), 0);
  for (int j = 0; j < n; ++j) {
    if (size[j] != j - first[j] + 1) return false;
    if (parent[j] < 0) continue;
    if (parent[j] <= j) return false;
    first[parent[j]] = std::min(first[parent[j]], first[j]);
    size[parent[j]] += size[j];
  }
  return true;
}

}  // namespace bundle
