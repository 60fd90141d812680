#include "core/io/colmap_contents.h"

#include <utility>

#include "core/io/colmap_binary_records.h"
#include "core/io/text_cursor.h"

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

/// Keeps colours and tracks.
struct KeepTracks {
  const char* contents;
  ColmapTracks tracks;

  void Begin(uint64_t count, uint64_t num_bytes) {
    tracks.colors.reserve(3 * count);
    tracks.lengths.reserve(count);
    tracks.elements.reserve((num_bytes - count * kPointRecordSize) / kTrackElementSize);
  }
  void Point(const ColmapIndex::Point& point, const std::vector<ColmapIndex::TrackElement>& track) {
    const char* color = contents + point.xyz_span.end;
    tracks.colors.insert(tracks.colors.end(), color, color + 3);
    tracks.lengths.push_back(static_cast<int64_t>(track.size()));
    tracks.elements.insert(tracks.elements.end(), track.begin(), track.end());
  }
};

}  // namespace

std::vector<double> ReadKeypoints(const ColmapModel& model) {
  const ModelFile& file = model.index.images_file;
  if (model.is_binary()) {
    KeepKeypoints sink;
    ScanImageRecords(file, &sink);
    return std::move(sink.xy);
  }
  std::vector<double> xy;
  ColmapTextCursor cursor(file);
  while (cursor.NextRecord()) {
    cursor.NextLine();
    while (!cursor.AtEndOfLine()) {
      xy.push_back(cursor.Number("x"));
      xy.push_back(cursor.Number("y"));
      cursor.SignedInteger("a point id");
    }
  }
  return xy;
}

ColmapTracks ReadTracks(const ColmapModel& model) {
  const ModelFile& file = model.index.points_file;
  if (model.is_binary()) {
    KeepTracks sink{file.contents().data(), {}};
    ScanPointRecords(file, &sink);
    return std::move(sink.tracks);
  }
  ColmapTracks tracks;
  ColmapTextCursor cursor(file);
  while (cursor.NextRecord()) {
    cursor.Token("a point id");
    for (int i = 0; i < 3; ++i) cursor.Number("a coordinate");
    for (int i = 0; i < 3; ++i) {
      tracks.colors.push_back(static_cast<uint8_t>(cursor.Integer("a colour", 255)));
    }
    cursor.Number("an error");
    const size_t before = tracks.elements.size();
    while (!cursor.AtEndOfLine()) {
      const uint32_t image_id = cursor.Id("an image id");
      tracks.elements.push_back(
          {image_id, static_cast<uint32_t>(cursor.Integer("a keypoint", kInvalidColmapId))});
    }
    tracks.lengths.push_back(static_cast<int64_t>(tracks.elements.size() - before));
  }
  return tracks;
}

}  // namespace bundle
