#include "core/io/bal_parts.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "core/io/bal_reader.h"
#include "core/io/input_file.h"

namespace bundle {

namespace {

struct Survey {
  BalSurvey found;

  void Begin(int32_t num_images, int32_t num_points, int32_t num_observations, uint64_t) {
    found.num_images = num_images;
    found.num_observations = num_observations;
    found.first_image.assign(num_points, num_images);
    found.last_image.assign(num_points, -1);
    found.num_seen.assign(num_points, 0);
  }
  void Observation(int32_t image, int32_t point, double, double) {
    found.first_image[point] = std::min(found.first_image[point], image);
    found.last_image[point] = std::max(found.last_image[point], image);
    ++found.num_seen[point];
  }
  void Point(const double*) {}
};

struct KeepPart {
  const LargeVector<int32_t>& place;
  BalProblem kept;
  size_t next_point = 0;

  void Begin(int32_t, int32_t num_points, int32_t num_observations, uint64_t stored_size) {
    if (static_cast<size_t>(num_points) != place.size()) FailAsChanged();
    const auto is_mine = [](int32_t p) { return p >= 0; };
    if (!std::all_of(place.begin(), place.end(), is_mine)) return;
    ReservePlausibly(&kept.observation_image, num_observations, 1, stored_size);
    ReservePlausibly(&kept.observation_point, num_observations, 1, stored_size);
    ReservePlausibly(&kept.observation_xy, num_observations, 2, stored_size);
    ReservePlausibly(&kept.points, num_points, 3, stored_size);
  }
  void Observation(int32_t image, int32_t point, double x, double y) {
    if (place[point] < 0) return;
    kept.observation_image.push_back(image);
    kept.observation_point.push_back(place[point]);
    kept.observation_xy.push_back(x);
    kept.observation_xy.push_back(y);
  }
  void Point(const double* xyz) {
    if (place[next_point++] >= 0) kept.points.insert(kept.points.end(), xyz, xyz + 3);
  }
};

}  // namespace

BalSurvey SurveyBal(const std::filesystem::path& path, const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  Survey sink;
  BalReader(*file, sink, on_block).Read();
  return std::move(sink.found);
}

BalProblem ReadBalPart(const std::filesystem::path& path, const LargeVector<int32_t>& place,
                       const std::function<void()>& on_block) {
  return ReadKept(path, KeepPart{place, {}}, on_block);
}

}  // namespace bundle
