#pragma once

/// The records of images.bin and points3D.bin, passed on one by one. The index of a complete model
/// stores all of them; a rank stores only its own. `colmap_binary_scanner.cpp` has the format.

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/io/colmap_byte_reader.h"
#include "core/io/colmap_index.h"

namespace bundle {

/// A `Sink` receives the contents of the file, in its order:
///     void Begin(uint64_t num_images, uint64_t num_bytes);
///     void Image(ColmapIndex::Image image);   // without first_keypoint; its keypoints follow
///     void Keypoint(uint64_t number, const double* xy, uint64_t point_id);
template <typename Sink>
void ScanImageRecords(const ModelFile& file, Sink* sink) {
  constexpr uint64_t kMinImageSize = 4 + 56 + 4 + 1 + 8;
  ByteReader reader(file);
  const auto count = reader.ReadCount<uint64_t>("images", kMinImageSize);
  sink->Begin(count, reader.num_left());
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = reader.ReadId("an image id");
    const std::string subject = "image " + std::to_string(id);
    std::array<double, 7> pose;
    reader.ReadArray(pose.data(), 7, "a pose");
    CheckPose(file, at + 4, subject, pose.data());
    const ColmapSpan pose_span{at + 4, reader.position()};
    const uint32_t camera_id = reader.ReadId("a camera id");
    const uint64_t name_at = reader.position();
    const std::string name(reader.ReadName(subject));
    CheckImageName(file, name_at, subject, name);
    const auto num_keypoints = reader.ReadCount<uint64_t>("keypoints of " + subject, kKeypointSize);
    const uint64_t keypoints_at = reader.position();
    sink->Image({id, camera_id, at, keypoints_at, 0, num_keypoints, name, pose, pose_span});
    for (uint64_t k = 0; k < num_keypoints; ++k) {
      double xy[2];
      reader.ReadArray(xy, 2, "a keypoint");
      if (!std::isfinite(xy[0]) || !std::isfinite(xy[1])) {
        file.Fail(keypoints_at + k * kKeypointSize, subject + ", keypoint " + std::to_string(k) +
                                                        ": expected finite coordinates, found " +
                                                        FormatNumber(xy[0]) + " " +
                                                        FormatNumber(xy[1]));
      }
      sink->Keypoint(k, xy, reader.Read<uint64_t>("a point id"));
    }
  }
  reader.ExpectEnd();
}

/// A `Sink` receives the contents of the file, in its order:
///     void Begin(uint64_t num_points, uint64_t num_bytes);
///     void Point(ColmapIndex::Point point,    // without first_element
///                const std::vector<ColmapIndex::TrackElement>& track);
template <typename Sink>
void ScanPointRecords(const ModelFile& file, Sink* sink) {
  ByteReader reader(file);
  const auto count = reader.ReadCount<uint64_t>("points", kPointRecordSize);
  sink->Begin(count, reader.num_left());
  std::vector<ColmapIndex::TrackElement> track;
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const auto id = reader.Read<uint64_t>("a point id");
    if (id > kMaxPoint3DId) {
      file.Fail(at, "expected a point id below 2^63, found " + std::to_string(id));
    }
    std::array<double, 3> xyz;
    reader.ReadArray(xyz.data(), 3, "a position");
    const ColmapSpan xyz_span{at + 8, reader.position()};
    if (!std::isfinite(xyz[0]) || !std::isfinite(xyz[1]) || !std::isfinite(xyz[2])) {
      file.Fail(at + 8, "point " + std::to_string(id) + ": expected a finite position, found " +
                            FormatNumber(xyz[0]) + " " + FormatNumber(xyz[1]) + " " +
                            FormatNumber(xyz[2]));
    }
    uint8_t rgb[3];
    reader.ReadArray(rgb, 3, "a colour");
    const uint64_t error_at = reader.position();
    reader.Read<double>("an error");  // may have any value: it is recomputed
    const ColmapSpan error_span{error_at, reader.position()};
    track.resize(reader.ReadCount<uint64_t>("track elements", kTrackElementSize));
    reader.ReadArray(track.data(), track.size(), "a track");
    sink->Point({id, at, 0, xyz, xyz_span, error_span}, track);
  }
  reader.ExpectEnd();
}

}  // namespace bundle
