#include "core/pose_graph/closures.h"

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <numeric>

namespace bundle {
namespace {

/// The letter of a key of GTSAM; 0 for any other id. Time stamps in nanoseconds are below 'A' << 56
/// until the year 2118.
int64_t LetterOf(int64_t id) {
  const int64_t upper = id >> 56;
  return upper >= 'A' ? upper : 0;
}

}  // namespace

IdOrder OrderOfIds(int64_t num_poses, const int64_t* ids) {
  IdOrder order;
  order.pose.resize(num_poses);
  std::iota(order.pose.begin(), order.pose.end(), 0);
  if (!std::is_sorted(ids, ids + num_poses)) {
    std::sort(order.pose.begin(), order.pose.end(),
              [&](int32_t a, int32_t b) { return ids[a] < ids[b]; });
  }
  order.rank.resize(num_poses);
  for (size_t k = 0; k < order.pose.size(); ++k) {
    order.rank[order.pose[k]] = static_cast<int32_t>(k);
  }
  return order;
}

bool IsClosure(const IdOrder& order, const int64_t* ids, int32_t first, int32_t second) {
  return std::abs(order.rank[first] - order.rank[second]) != 1 ||
         LetterOf(ids[first]) != LetterOf(ids[second]);
}

}  // namespace bundle
