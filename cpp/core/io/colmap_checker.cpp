#include "core/io/colmap_checker.h"

/// Reads the files of a COLMAP model and checks that its references resolve.

#include <algorithm>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/io/colmap_binary_scanner.h"
#include "core/io/colmap_file_records.h"
#include "core/io/colmap_id_map.h"
#include "core/io/colmap_index.h"
#include "core/io/colmap_scanner.h"
#include "core/io/colmap_text_scanner.h"
#include "core/io/colmap_track_errors.h"
#include "core/io/printable.h"

namespace bundle {

namespace {

std::string JoinPath(const std::string& folder, const char* stem, const char* extension) {
  return (std::filesystem::path(folder) / (std::string(stem) + extension)).string();
}

bool Exists(const std::string& folder, const char* stem, const ColmapScanner& scanner) {
  std::error_code ignored;
  return std::filesystem::is_regular_file(JoinPath(folder, stem, scanner.extension), ignored);
}

/// The names of the files of this format that are missing in the folder.
std::string MissingFiles(const std::string& folder, const ColmapScanner& scanner) {
  std::string missing;
  for (const char* stem : {"cameras", "images", "points3D"}) {
    if (Exists(folder, stem, scanner)) continue;
    missing += (missing.empty() ? "" : ", ") + std::string(stem) + scanner.extension;
  }
  return missing;
}

/// Keeps images and their keypoints in the index.
struct KeepImages {
  ColmapIndex* index;

  void Begin(uint64_t count, uint64_t) const { index->images.reserve(count); }
  void Image(ColmapIndex::Image image) const {
    image.first_keypoint = index->keypoints.size();
    index->images.push_back(std::move(image));
  }
  void Keypoint(uint64_t number, const double* xy, uint64_t point_id) const {
    index->images.back().num_keypoints = number + 1;  // not known before in text
    const bool has_point = point_id != kInvalidPoint3DId;
    index->keypoints.Add(has_point);
    if (!has_point) return;
    index->seen_point_ids.push_back(point_id);
    index->seen_xy.insert(index->seen_xy.end(), {xy[0], xy[1]});
  }
};

/// Keeps points and their tracks in the index.
struct KeepPoints {
  ColmapIndex* index;

  void Begin(uint64_t count, uint64_t) const {
    index->points.reserve(count);
    index->track_elements.reserve(index->seen_point_ids.size());
  }
  void Point(const ColmapPointRecord& point,
             const std::vector<ColmapIndex::TrackElement>& track) const {
    index->points.push_back({point.id, point.at, index->track_elements.size(), point.xyz});
    index->track_elements.insert(index->track_elements.end(), track.begin(), track.end());
  }
};

ColmapIndex ScanFiles(const std::string& folder, const ColmapScanner& scanner) {
  ColmapIndex index;
  index.kind = scanner.kind;
  const auto scan = [&](const char* stem, ModelFile* file, void (*scan_file)(ColmapIndex*)) {
    *file = ModelFile(JoinPath(folder, stem, scanner.extension), scanner.kind);
    scan_file(&index);
  };
  if (Exists(folder, "rigs", scanner)) scan("rigs", &index.rigs_file, scanner.scan_rigs);
  scan("cameras", &index.cameras_file, scanner.scan_cameras);
  if (Exists(folder, "frames", scanner)) scan("frames", &index.frames_file, scanner.scan_frames);
  scan("images", &index.images_file, [](ColmapIndex* found) {
    KeepImages sink{found};
    ScanImageRecords(found->images_file, &sink);
  });
  scan("points3D", &index.points_file, [](ColmapIndex* found) {
    KeepPoints sink{found};
    ScanPointRecords(found->points_file, &sink);
  });
  return index;
}

void CheckNotEmpty(const ColmapIndex& index) {
  const uint64_t start = index.kind == ModelFile::Kind::kText ? 1 : 0;
  if (index.cameras.empty()) index.cameras_file.Fail(start, "expected a camera, found 0");
  if (index.images.empty()) index.images_file.Fail(start, "expected an image, found 0");
}

}  // namespace

ColmapIndex ScanColmapModel(const std::string& folder) {
  const std::string missing_binary = MissingFiles(folder, kColmapBinaryScanner);
  const std::string missing_text = MissingFiles(folder, kColmapTextScanner);
  if (!missing_binary.empty() && !missing_text.empty()) {
    throw InputError(Printable(folder) + ": expected the files of a COLMAP model, found no " +
                     missing_binary + " (binary) and no " + missing_text + " (text)");
  }
  const bool binary = missing_binary.empty();
  ColmapIndex index = ScanFiles(folder, binary ? kColmapBinaryScanner : kColmapTextScanner);
  return index;
}

namespace {

std::string Name(const ColmapIndex::Sensor& sensor) {
  return RecordName(sensor.type == SensorType::kCamera ? "camera" : "IMU", sensor.id);
}

void CheckRigs(const ColmapIndex& index, const IdMap& cameras) {
  for (const ColmapIndex::Rig& rig : index.rigs) {
    for (auto sensor = rig.sensors.begin(); sensor != rig.sensors.end(); ++sensor) {
      if (std::find(rig.sensors.begin(), sensor, *sensor) != sensor) {
        index.rigs_file.Fail(rig.at, RecordName("rig", rig.id) +
                                         ": expected each sensor once, found " + Name(*sensor) +
                                         " again");
      }
      if (sensor->type == SensorType::kCamera && cameras.Find(sensor->id) == IdMap::kNone) {
        index.rigs_file.Fail(
            rig.at,
            RecordName("rig", rig.id) + ": expected a camera of the model, found " + Name(*sensor));
      }
    }
  }
}

/// Checks frames against rigs and images; `frame_of_image` becomes the frame of each image.
void CheckFrames(const ColmapIndex& index, const IdMap& rigs, const IdMap& images,
                 std::vector<int64_t>* frame_of_image) {
  for (size_t f = 0; f < index.frames.size(); ++f) {
    const ColmapIndex::Frame& frame = index.frames[f];
    const auto fail = [&](const std::string& message) {
      index.frames_file.Fail(frame.at, RecordName("frame", frame.id) + ": " + message);
    };
    const int64_t r = rigs.Find(frame.rig_id);
    if (r == IdMap::kNone)
      fail("expected a rig of the model, found " + RecordName("rig", frame.rig_id));
    const std::vector<ColmapIndex::Sensor>& sensors = index.rigs[static_cast<size_t>(r)].sensors;
    for (const ColmapIndex::Datum& datum : frame.data) {
      if (std::find(sensors.begin(), sensors.end(), datum.sensor) == sensors.end()) {
        fail("expected a sensor of " + RecordName("rig", frame.rig_id) + ", found " +
             Name(datum.sensor));
      }
      if (datum.sensor.type != SensorType::kCamera) continue;
      const int64_t i = images.Find(datum.id);
      if (i == IdMap::kNone)
        fail("expected an image of the model, found " + RecordName("image", datum.id));
      const ColmapIndex::Image& image = index.images[static_cast<size_t>(i)];
      if (image.camera_id != datum.sensor.id) {
        fail("expected " + RecordName("image", image.id) + " with its " +
             RecordName("camera", image.camera_id) + ", found " + Name(datum.sensor));
      }
      if (std::exchange((*frame_of_image)[static_cast<size_t>(i)], static_cast<int64_t>(f)) !=
          IdMap::kNone) {
        fail("expected each image in one frame, found " + RecordName("image", image.id) + " again");
      }
    }
  }
}

void CheckImages(const ColmapIndex& index, const IdMap& cameras,
                 const std::vector<int64_t>& frame_of_image) {
  // Older models have no rigs and frames: COLMAP makes one rig per camera and one frame per image.
  const bool has_frames = !index.rigs.empty() || !index.frames.empty();
  for (size_t i = 0; i < index.images.size(); ++i) {
    const ColmapIndex::Image& image = index.images[i];
    if (cameras.Find(image.camera_id) == IdMap::kNone) {
      index.images_file.Fail(image.at, RecordName("image", image.id) +
                                           ": expected a camera of the model, found " +
                                           RecordName("camera", image.camera_id));
    }
    if (has_frames && frame_of_image[i] == IdMap::kNone) {
      index.images_file.Fail(
          image.at, RecordName("image", image.id) + ": expected a frame that holds it, found 0");
    }
  }
}

void CheckPointIdsUnique(const ColmapIndex& index) {
  std::vector<std::pair<uint64_t, uint64_t>> ids;  // id and place
  ids.reserve(index.points.size());
  for (const ColmapIndex::Point& point : index.points) ids.emplace_back(point.id, point.at);
  if (!std::is_sorted(ids.begin(), ids.end())) std::sort(ids.begin(), ids.end());
  const auto same_id = [](const auto& a, const auto& b) { return a.first == b.first; };
  const auto twin = std::adjacent_find(ids.begin(), ids.end(), same_id);
  if (twin == ids.end()) return;
  const auto& [id, at] = *std::next(twin);
  index.points_file.Fail(at,
                         "expected each point once, found " + RecordName("point", id) + " again");
}

/// Checks tracks against keypoints: each must refer to the other once. Returns the position of the
/// point of each keypoint that has one.
std::vector<int32_t> CheckTracks(const ColmapIndex& index, const IdMap& images) {
  constexpr int32_t kNone = -1;
  std::vector<int32_t> point_of_seen(index.seen_point_ids.size(), kNone);
  for (size_t p = 0; p < index.points.size(); ++p) {
    const ColmapIndex::Point& point = index.points[p];
    const uint64_t last = p + 1 < index.points.size() ? index.points[p + 1].first_element
                                                      : index.track_elements.size();
    for (uint64_t e = point.first_element; e < last; ++e) {
      const ColmapIndex::TrackElement& element = index.track_elements[e];
      const auto fail = [&](const std::string& message) {
        index.points_file.Fail(index.TrackElementPlace(point, e - point.first_element),
                               RecordName("point", point.id) + ": " + message);
      };
      const int64_t i = images.Find(element.image_id);
      if (i == IdMap::kNone) fail(NoSuchImage(element));
      const ColmapIndex::Image& image = index.images[static_cast<size_t>(i)];
      if (element.keypoint >= image.num_keypoints) fail(NoSuchKeypoint(element, image));
      const uint64_t keypoint = image.first_keypoint + element.keypoint;
      if (!index.keypoints.IsMarked(keypoint)) fail(RefersElsewhere(element, kInvalidPoint3DId));
      const size_t seen = index.keypoints.Row(keypoint);
      const uint64_t point_id = index.seen_point_ids[seen];
      if (point_id != point.id) fail(RefersElsewhere(element, point_id));
      if (point_of_seen[seen] != kNone) fail(VisitedAgain(element));
      point_of_seen[seen] = static_cast<int32_t>(p);
    }
  }
  if (std::find(point_of_seen.begin(), point_of_seen.end(), kNone) == point_of_seen.end()) {
    return point_of_seen;
  }
  for (const ColmapIndex::Image& image : index.images) {
    for (uint64_t k = 0; k < image.num_keypoints; ++k) {
      const uint64_t keypoint = image.first_keypoint + k;
      if (!index.keypoints.IsMarked(keypoint)) continue;
      const size_t seen = index.keypoints.Row(keypoint);
      if (point_of_seen[seen] != kNone) continue;
      index.images_file.Fail(index.KeypointPlace(image, k),
                             NotInTrack(image, k, index.seen_point_ids[seen]));
    }
  }
  return point_of_seen;
}

}  // namespace

uint64_t ColmapIndex::KeypointPlace(const Image& image, uint64_t keypoint) const {
  return image.keypoints_at + (kind == ModelFile::Kind::kBinary ? keypoint * kKeypointSize : 0);
}

uint64_t ColmapIndex::TrackElementPlace(const Point& point, uint64_t element) const {
  return point.at +
         (kind == ModelFile::Kind::kBinary ? kPointRecordSize + element * kTrackElementSize : 0);
}

IdMap CheckColmapViews(const ColmapIndex& index, bool may_be_empty) {
  if (!may_be_empty) CheckNotEmpty(index);
  const IdMap cameras(index.cameras, index.cameras_file, "camera");
  const IdMap rigs(index.rigs, index.rigs_file, "rig");
  const IdMap frames(index.frames, index.frames_file, "frame");
  IdMap images(index.images, index.images_file, "image");
  std::vector<int64_t> frame_of_image(index.images.size(), IdMap::kNone);
  CheckRigs(index, cameras);
  CheckFrames(index, rigs, images, &frame_of_image);
  CheckImages(index, cameras, frame_of_image);
  return images;
}

std::vector<int32_t> CheckColmapReferences(const ColmapIndex& index, bool may_be_empty) {
  const IdMap images = CheckColmapViews(index, may_be_empty);
  CheckPointIdsUnique(index);
  return CheckTracks(index, images);
}

}  // namespace bundle
