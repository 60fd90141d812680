#include "core/io/colmap_contents.h"

#include <utility>

#include "core/io/colmap_file_records.h"

namespace bundle {
namespace {

/// Keeps the coordinates of keypoints.
struct KeepKeypoints {
  std::vector<double> xy;

  void Begin(uint64_t, uint64_t num_bytes) { xy.reserve(2 * (num_bytes / kKeypointSize)); }
  void Image(const ColmapIndex::Image&) {}
  void Keypoint(uint64_t, const double* keypoint, uint64_t) {
    xy.insert(xy.end(), keypoint, keypoint + 2);
  }
};

/// Keeps ids, colours and tracks.
struct KeepTracks {
  ColmapTracks tracks;

  void Begin(uint64_t count, uint64_t num_bytes) {
    tracks.point_ids.reserve(count);
    tracks.colors.reserve(3 * count);
    tracks.lengths.reserve(count);
    tracks.elements.reserve((num_bytes - count * kPointRecordSize) / kTrackElementSize);
  }
  void Point(const ColmapPointRecord& point, const std::vector<ColmapIndex::TrackElement>& track) {
    tracks.point_ids.push_back(static_cast<int64_t>(point.id));
    tracks.colors.insert(tracks.colors.end(), point.color.begin(), point.color.end());
    tracks.lengths.push_back(static_cast<int64_t>(track.size()));
    tracks.elements.insert(tracks.elements.end(), track.begin(), track.end());
  }
};

}  // namespace

std::vector<double> ReadKeypoints(const ColmapModel& model) {
  KeepKeypoints sink;
  ScanImageRecords(model.index.images_file, &sink);
  return std::move(sink.xy);
}

ColmapTracks ReadTracks(const ColmapModel& model) {
  KeepTracks sink;
  ScanPointRecords(model.index.points_file, &sink);
  return std::move(sink.tracks);
}

}  // namespace bundle
