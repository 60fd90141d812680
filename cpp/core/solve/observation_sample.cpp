#include "core/solve/observation_sample.h"

#include <algorithm>
#include <map>

namespace bundle {
namespace {

/// splitmix64 (Steele, Lea and Flood, OOPSLA 2014) of a counter: a uniform number in [0, 1).
double Uniform(int counter) {
  uint64_t z = (static_cast<uint64_t>(counter) + 1) * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

}  // namespace

std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size) {
  std::vector<int64_t> observed(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) ++observed[problem.observation_image[i]];
  std::map<const CameraModel*, int64_t> images;  // with observations
  const auto model_of = [&](int image) {
    return problem.camera_models[problem.image_camera[image]];
  };
  for (int i = 0; i < problem.num_images; ++i) {
    if (observed[i] > 0) ++images[model_of(i)];
  }
  // Each image draws at even distances, beginning anywhere.
  std::vector<double> share(problem.num_images), due(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    if (observed[i] == 0) continue;
    const auto drawn = static_cast<double>(size) / (static_cast<double>(images.size()) *
                                                    static_cast<double>(images[model_of(i)]));
    share[i] = std::min(1.0, drawn / static_cast<double>(observed[i]));
    due[i] = Uniform(i);
  }
  std::vector<int64_t> sample;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i];
    due[image] += share[image];
    if (due[image] < 1) continue;
    due[image] -= 1;
    sample.push_back(i);
  }
  return sample;
}

}  // namespace bundle
