#include "core/io/colmap_parts.h"

/// A part is read in two passes. points3D.bin gives its points and their tracks, which determine
/// the place of each observation. images.bin then gives the pixels. The files contradict each other
/// if a keypoint has no such place, or if a place gets no keypoint. In addition to its data, a part
/// needs only eight bytes of memory per observation.

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "core/io/colmap_checker.h"
#include "core/io/colmap_file_records.h"
#include "core/io/colmap_id_map.h"
#include "core/io/colmap_index.h"
#include "core/io/colmap_survey.h"
#include "core/io/colmap_track_errors.h"
#include "core/io/input_file.h"
#include "core/scratch/large_vector.h"

namespace bundle {
namespace {

/// Rows of points by id.
class PointRows {
 public:
  static constexpr int32_t kNone = -1;

  explicit PointRows(const LargeVector<int64_t>& ids) : ids_(ids) {
    if (ids.empty() || ids.back() >= static_cast<int64_t>(8 * ids.size() + 1024)) return;
    dense_.assign(static_cast<size_t>(ids.back()) + 1, kNone);
    for (size_t row = 0; row < ids.size(); ++row) {
      dense_[static_cast<size_t>(ids[row])] = static_cast<int32_t>(row);
    }
  }

  int32_t Find(uint64_t id) const {
    if (!dense_.empty()) return id < dense_.size() ? dense_[id] : kNone;
    if (id > kMaxPoint3DId) return kNone;
    const auto found = std::lower_bound(ids_.begin(), ids_.end(), static_cast<int64_t>(id));
    const bool is_there = found != ids_.end() && *found == static_cast<int64_t>(id);
    return is_there ? static_cast<int32_t>(found - ids_.begin()) : kNone;
  }

 private:
  const LargeVector<int64_t>& ids_;
  LargeVector<int32_t> dense_;
};

bool Before(const ColmapIndex::TrackElement& a, const ColmapIndex::TrackElement& b) {
  return std::tie(a.image_id, a.keypoint) < std::tie(b.image_id, b.keypoint);
}

/// Points of a part and their tracks. `tracks` is sorted by place, image id and keypoint in the
/// end.
struct PartOfPoints {
  struct Record {
    uint64_t id = kInvalidPoint3DId;
    uint64_t at = 0;
    uint64_t first = 0;  ///< in `tracks`
    uint64_t length = 0;
  };
  const PointRows& rows;
  const LargeVector<int32_t>& place;
  LargeVector<double> points;
  LargeVector<Record> records;  ///< by place
  LargeVector<ColmapIndex::TrackElement> tracks;

  void Begin(uint64_t count, uint64_t) {
    if (count != place.size()) FailAsChanged();
    const auto kept = std::count_if(place.begin(), place.end(), [](int32_t p) { return p >= 0; });
    points.resize(3 * static_cast<size_t>(kept), 0.0);
    records.resize(static_cast<size_t>(kept));
  }
  void Point(const ColmapPointRecord& point, const std::vector<ColmapIndex::TrackElement>& track) {
    const int32_t row = rows.Find(point.id);
    if (row == PointRows::kNone) FailAsChanged();
    if (place[static_cast<size_t>(row)] < 0) return;
    const auto to = static_cast<size_t>(place[static_cast<size_t>(row)]);
    std::copy(point.xyz.begin(), point.xyz.end(),
              points.begin() + static_cast<std::ptrdiff_t>(3 * to));
    records[to] = {point.id, point.at, tracks.size(), track.size()};
    tracks.insert(tracks.end(), track.begin(), track.end());
  }

  void Sort() {
    const auto range = [](const Record& record, auto begin) {
      return begin + static_cast<std::ptrdiff_t>(record.first);
    };
    bool is_in_order = true;
    for (size_t p = 1; p < records.size(); ++p) {
      is_in_order = is_in_order && records[p - 1].first <= records[p].first;
    }
    if (!is_in_order) {
      LargeVector<ColmapIndex::TrackElement> ordered;
      ordered.reserve(tracks.size());
      for (Record& record : records) {
        const auto begin = range(record, tracks.begin());
        record.first = ordered.size();
        ordered.insert(ordered.end(), begin, begin + static_cast<std::ptrdiff_t>(record.length));
      }
      tracks = std::move(ordered);
    }
    for (const Record& record : records) {
      const auto begin = range(record, tracks.begin());
      std::sort(begin, begin + static_cast<std::ptrdiff_t>(record.length), Before);
    }
  }

  /// Row of an element of a track; `tracks.size()` if the track has no such element.
  size_t Find(const Record& record, const ColmapIndex::TrackElement& element) const {
    const auto begin = tracks.begin() + static_cast<std::ptrdiff_t>(record.first);
    const auto end = begin + static_cast<std::ptrdiff_t>(record.length);
    const auto found = std::lower_bound(begin, end, element, Before);
    const bool is_there = found != end && !Before(element, *found);
    return is_there ? static_cast<size_t>(found - tracks.begin()) : tracks.size();
  }
};

/// Images, and the pixels of the part's tracks.
struct PartOfImages {
  const PointRows& rows;
  const LargeVector<int32_t>& place;
  const PartOfPoints& part;
  ColmapIndex* index;
  ColmapObservations* found;
  std::optional<ColmapPart::Failure>* failure;

  void Begin(uint64_t, uint64_t) const {
    const size_t size = part.tracks.size();
    found->image.resize(size, 0);
    found->point.resize(size, 0);
    found->keypoint.resize(size, 0);
    found->xy.assign(2 * size, std::numeric_limits<double>::quiet_NaN());
  }
  void Image(ColmapIndex::Image image) const { index->images.push_back(std::move(image)); }
  void Keypoint(uint64_t number, const double* xy, uint64_t point_id) const {
    if (point_id == kInvalidPoint3DId) return;
    const ColmapIndex::Image& image = index->images.back();
    const int32_t row = rows.Find(point_id);
    if (row == PointRows::kNone) return Fail(image, number, point_id);
    const int32_t to = place[static_cast<size_t>(row)];
    if (to < 0) return;
    const PartOfPoints::Record& record = part.records[static_cast<size_t>(to)];
    const size_t at = part.Find(record, {image.id, static_cast<uint32_t>(number)});
    if (at == part.tracks.size()) return Fail(image, number, point_id);
    found->image[at] = static_cast<int32_t>(index->images.size() - 1);
    found->point[at] = to;
    found->keypoint[at] = static_cast<int32_t>(number);
    std::copy_n(xy, 2, found->xy.begin() + static_cast<std::ptrdiff_t>(2 * at));
  }
  void Fail(const ColmapIndex::Image& image, uint64_t number, uint64_t point_id) const {
    if (failure->has_value()) return;  // the file is read from its beginning
    const uint64_t position = index->KeypointPlace(image, number);
    *failure = {true, position,
                index->images_file.Complaint(position, NotInTrack(image, number, point_id))};
  }
};

/// Finds the first error in the track of a point, in the order of the file; empty if the track is
/// valid.
std::optional<ColmapPart::Failure> CheckTrack(const ColmapIndex& index, const IdMap& images,
                                              const PartOfPoints& part,
                                              const PartOfPoints::Record& record,
                                              const LargeVector<double>& xy) {
  std::vector<ColmapIndex::TrackElement> track(record.length);
  index.points_file.ReadAt(record.at + kPointRecordSize, reinterpret_cast<char*>(track.data()),
                           track.size() * kTrackElementSize);
  std::vector<size_t> visited;
  for (size_t e = 0; e < track.size(); ++e) {
    const auto fail = [&](const std::string& message) -> ColmapPart::Failure {
      const uint64_t position = record.at + kPointRecordSize + e * kTrackElementSize;
      return {
          false, position,
          index.points_file.Complaint(position, RecordName("point", record.id) + ": " + message)};
    };
    const int64_t position = images.Find(track[e].image_id);
    if (position == IdMap::kNone) return fail(NoSuchImage(track[e]));
    const ColmapIndex::Image& image = index.images[static_cast<size_t>(position)];
    if (track[e].keypoint >= image.num_keypoints) return fail(NoSuchKeypoint(track[e], image));
    const size_t row = part.Find(record, track[e]);
    if (std::isnan(xy[2 * row])) {
      uint64_t point_id = 0;
      const uint64_t at = index.KeypointPlace(image, track[e].keypoint) + 2 * sizeof(double);
      index.images_file.ReadAt(at, reinterpret_cast<char*>(&point_id), sizeof(point_id));
      return fail(RefersElsewhere(track[e], point_id));
    }
    if (std::find(visited.begin(), visited.end(), row) != visited.end()) {
      return fail(VisitedAgain(track[e]));
    }
    visited.push_back(row);
  }
  return std::nullopt;
}

/// Finds the first contradiction in points3D.bin: a place without a keypoint.
void CheckTracksOfPart(const ColmapIndex& index, const IdMap& images, const PartOfPoints& part,
                       const LargeVector<double>& xy, std::optional<ColmapPart::Failure>* failure) {
  for (const PartOfPoints::Record& record : part.records) {
    bool is_filled = true;
    for (uint64_t row = record.first; row < record.first + record.length; ++row) {
      is_filled = is_filled && !std::isnan(xy[2 * row]);
    }
    if (is_filled) continue;
    std::optional<ColmapPart::Failure> found = CheckTrack(index, images, part, record, xy);
    if (!found.has_value()) continue;
    const bool is_first =
        !failure->has_value() || (*failure)->is_in_images || found->position < (*failure)->position;
    if (is_first) *failure = std::move(found);
  }
}

}  // namespace

ColmapPart ReadColmapPart(const std::string& folder, const LargeVector<int64_t>& point_ids,
                          const LargeVector<int32_t>& place,
                          const std::function<void()>& on_block) {
  ColmapPart result;
  result.model.index = OpenColmapModel(folder, on_block);
  ColmapIndex& index = result.model.index;
  const PointRows point_rows(point_ids);
  PartOfPoints part{point_rows, place, {}, {}, {}};
  ScanPointRecords(index.points_file, &part);
  part.Sort();
  PartOfImages pixels{point_rows, place, part, &index, &result.observations, &result.failure};
  ScanImageRecords(index.images_file, &pixels);
  const IdMap images = CheckColmapViews(index);
  OrderViews(&result.model);
  CheckTracksOfPart(index, images, part, result.observations.xy, &result.failure);
  const std::vector<int32_t> rows = RowsOfImages(result.model);
  for (int32_t& image : result.observations.image) image = rows[static_cast<size_t>(image)];
  result.points = std::move(part.points);
  return result;
}

}  // namespace bundle
