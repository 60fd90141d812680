#include "core/problem/tracks.h"

#include <numeric>

namespace bundle {

std::vector<int64_t> TrackLengths(const ProblemView& problem) {
  std::vector<int64_t> lengths(problem.num_points);
  for (int64_t i = 0; i < problem.num_observations; ++i) ++lengths[problem.observation_point[i]];
  return lengths;
}

Tracks GroupByPoint(const ProblemView& problem) {
  const std::vector<int64_t> lengths = TrackLengths(problem);
  Tracks tracks;
  tracks.starts.resize(lengths.size() + 1);
  std::partial_sum(lengths.begin(), lengths.end(), tracks.starts.begin() + 1);
  tracks.images.resize(problem.num_observations);
  std::vector<int64_t> next(tracks.starts.begin(), tracks.starts.end() - 1);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    tracks.images[next[problem.observation_point[i]]++] = problem.observation_image[i];
  }
  return tracks;
}

}  // namespace bundle
