#include "core/io/colmap_survey.h"

/// Binary COLMAP models as streams: the data that all parts share, and the images that see each
/// point.

#include <algorithm>
#include <filesystem>
#include <numeric>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "core/io/colmap_binary_scanner.h"
#include "core/io/colmap_checker.h"
#include "core/io/colmap_file_records.h"
#include "core/io/colmap_id_map.h"
#include "core/io/colmap_index.h"

namespace bundle {

/// Scans rigs, cameras and frames and opens the other two files.
ColmapIndex OpenColmapModel(const std::string& folder, const std::function<void()>& on_block) {
  constexpr ModelFile::Kind kKind = ModelFile::Kind::kBinary;
  ColmapIndex index;
  index.kind = kKind;
  const auto path = [&](const char* name) {
    return (std::filesystem::path(folder) / name).string();
  };
  const auto scan = [&](const char* name, ModelFile* file, void (*scan_file)(ColmapIndex*)) {
    *file = ModelFile(path(name), kKind);
    scan_file(&index);
  };
  const auto scan_if_there = [&](const char* name, ModelFile* file,
                                 void (*scan_file)(ColmapIndex*)) {
    std::error_code ignored;
    if (std::filesystem::is_regular_file(path(name), ignored)) scan(name, file, scan_file);
  };
  scan_if_there("rigs.bin", &index.rigs_file, kColmapBinaryScanner.scan_rigs);
  scan("cameras.bin", &index.cameras_file, kColmapBinaryScanner.scan_cameras);
  scan_if_there("frames.bin", &index.frames_file, kColmapBinaryScanner.scan_frames);
  index.images_file = ModelFile::Stream(path("images.bin"), kKind, on_block);
  index.points_file = ModelFile::Stream(path("points3D.bin"), kKind, on_block);
  return index;
}

/// Orders the cameras and images of the index by id, and finds the rigs. Points are not needed.
void OrderViews(ColmapModel* model) {
  model->cameras_by_id = OrderById(model->index.cameras);
  model->images_by_id = OrderById(model->index.images);
  FindColmapRigs(model);
}

/// Per image of the file: its row in the problem's arrays.
std::vector<int32_t> RowsOfImages(const ColmapModel& model) {
  std::vector<int32_t> rows(model.images_by_id.size());
  for (size_t row = 0; row < rows.size(); ++row) {
    rows[model.images_by_id[row]] = static_cast<int32_t>(row);
  }
  return rows;
}

namespace {

struct KeepViews {
  std::vector<ColmapIndex::Image>* images;

  void Begin(uint64_t, uint64_t) const {}
  void Image(ColmapIndex::Image image) const { images->push_back(std::move(image)); }
  void Keypoint(uint64_t, const double*, uint64_t) const {}
};

struct SurveyTracks {
  const IdMap& images;
  const std::vector<int32_t>& rows;
  ColmapSurvey found{};

  void Begin(uint64_t count, uint64_t) {
    found.num_images = static_cast<int64_t>(rows.size());
    for (auto* column : {&found.first_image, &found.last_image, &found.num_seen}) {
      column->reserve(count);
    }
    found.point_ids.reserve(count);
  }
  void Point(const ColmapPointRecord& point, const std::vector<ColmapIndex::TrackElement>& track) {
    auto first = static_cast<int32_t>(rows.size());
    int32_t last = -1;
    for (const ColmapIndex::TrackElement& element : track) {
      const int64_t position = images.Find(element.image_id);
      if (position == IdMap::kNone) continue;  // the part that has the point says so
      first = std::min(first, rows[static_cast<size_t>(position)]);
      last = std::max(last, rows[static_cast<size_t>(position)]);
    }
    found.point_ids.push_back(static_cast<int64_t>(point.id));
    found.first_image.push_back(first);
    found.last_image.push_back(last);
    found.num_seen.push_back(static_cast<int32_t>(track.size()));
    found.num_observations += static_cast<int64_t>(track.size());
  }
};

/// Throws an error about the second of two points with this id.
struct FindTwin {
  const ModelFile& file;
  uint64_t id;
  int num_found = 0;

  void Begin(uint64_t, uint64_t) const {}
  void Point(const ColmapPointRecord& point, const std::vector<ColmapIndex::TrackElement>&) {
    if (point.id != id || ++num_found < 2) return;
    file.Fail(point.at, "expected each point once, found " + RecordName("point", id) + " again");
  }
};

template <typename T>
void Permute(const std::vector<size_t>& order, LargeVector<T>* values) {
  LargeVector<T> permuted(order.size());
  std::transform(order.begin(), order.end(), permuted.begin(),
                 [&](size_t position) { return (*values)[position]; });
  *values = std::move(permuted);
}

void SortById(const ModelFile& file, ColmapSurvey* survey) {
  LargeVector<int64_t>& ids = survey->point_ids;
  if (!std::is_sorted(ids.begin(), ids.end())) {
    std::vector<size_t> order(ids.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return ids[a] < ids[b]; });
    for (auto* column : {&survey->first_image, &survey->last_image, &survey->num_seen}) {
      Permute(order, column);
    }
    Permute(order, &ids);
  }
  const auto twin = std::adjacent_find(ids.begin(), ids.end());
  if (twin == ids.end()) return;
  FindTwin sink{file, static_cast<uint64_t>(*twin)};
  ScanPointRecords(file, &sink);
}

}  // namespace

ColmapSurvey SurveyColmap(const std::string& folder, const std::function<void()>& on_block) {
  ColmapModel model;
  model.index = OpenColmapModel(folder, on_block);
  ColmapIndex& index = model.index;
  KeepViews views{&index.images};
  ScanImageRecords(index.images_file, &views);
  const IdMap images = CheckColmapViews(index);
  OrderViews(&model);
  const std::vector<int32_t> rows = RowsOfImages(model);
  SurveyTracks tracks{images, rows};
  ScanPointRecords(index.points_file, &tracks);
  SortById(index.points_file, &tracks.found);
  return std::move(tracks.found);
}

}  // namespace bundle
