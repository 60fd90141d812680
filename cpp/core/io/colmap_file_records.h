#pragma once

/// The records of the images and the points file, in both formats, passed on one by one. The index
/// of a complete model stores all of them; a rank stores only its own. The two scanners
/// (`colmap_text_scanner.cpp`, `colmap_binary_scanner.cpp`) define the formats.

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/io/colmap_byte_reader.h"
#include "core/io/colmap_index.h"
#include "core/io/text_cursor.h"

namespace bundle {

/// A record of the points file before its track.
struct ColmapPointRecord {
  uint64_t id = 0;
  uint64_t at = 0;
  std::array<double, 3> xyz{};
  std::array<uint8_t, 3> color{};
  ColmapSpan xyz_span{};
  ColmapSpan error_span{};
};

template <typename Sink>
void ScanBinaryImages(const ModelFile& file, Sink* sink) {
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

template <typename Sink>
void ScanTextImages(const ModelFile& file, Sink* sink) {
  ColmapTextCursor cursor(file);
  while (cursor.NextRecord()) {
    ColmapIndex::Image image{};
    image.at = cursor.line();
    image.id = cursor.Id("an image id");
    const std::string subject = "image " + std::to_string(image.id);
    image.pose_span = cursor.Pose(subject, image.pose.data());
    image.camera_id = cursor.Id("a camera id");
    image.name = cursor.Rest("an image name");
    CheckImageName(file, image.at, subject, image.name);
    if (!cursor.NextLine()) {
      cursor.Fail(subject + ": expected a line of keypoints (blank without keypoints) after this " +
                  "line, found the end of the file");
    }
    image.keypoints_at = cursor.line();
    sink->Image(std::move(image));
    for (uint64_t k = 0; !cursor.AtEndOfLine(); ++k) {
      const double xy[2] = {cursor.Number("the x of a keypoint"),
                            cursor.Number("the y of a keypoint")};
      const int64_t point_id = cursor.SignedInteger("the point id of a keypoint");
      if (point_id < -1) {
        cursor.Fail("expected a point id, or -1 without a point, found " +
                    std::to_string(point_id));
      }
      sink->Keypoint(k, xy, static_cast<uint64_t>(point_id));  // -1: kInvalidPoint3DId
    }
  }
}

/// A `Sink` receives the contents of the file, in its order:
///     void Begin(uint64_t num_images, uint64_t num_bytes);   // only of a binary file
///     void Image(ColmapIndex::Image image);   // without first_keypoint; its keypoints follow
///     void Keypoint(uint64_t number, const double* xy, uint64_t point_id);
/// Images of a text file come without num_keypoints.
template <typename Sink>
void ScanImageRecords(const ModelFile& file, Sink* sink) {
  const bool is_binary = file.kind() == ModelFile::Kind::kBinary;
  is_binary ? ScanBinaryImages(file, sink) : ScanTextImages(file, sink);
}

template <typename Sink>
void ScanBinaryPoints(const ModelFile& file, Sink* sink) {
  ByteReader reader(file);
  const auto count = reader.ReadCount<uint64_t>("points", kPointRecordSize);
  sink->Begin(count, reader.num_left());
  std::vector<ColmapIndex::TrackElement> track;
  for (uint64_t i = 0; i < count; ++i) {
    ColmapPointRecord point;
    const uint64_t at = point.at = reader.position();
    const uint64_t id = point.id = reader.Read<uint64_t>("a point id");
    if (id > kMaxPoint3DId) {
      file.Fail(at, "expected a point id below 2^63, found " + std::to_string(id));
    }
    std::array<double, 3>& xyz = point.xyz;
    reader.ReadArray(xyz.data(), 3, "a position");
    point.xyz_span = {at + 8, reader.position()};
    if (!std::isfinite(xyz[0]) || !std::isfinite(xyz[1]) || !std::isfinite(xyz[2])) {
      file.Fail(at + 8, "point " + std::to_string(id) + ": expected a finite position, found " +
                            FormatNumber(xyz[0]) + " " + FormatNumber(xyz[1]) + " " +
                            FormatNumber(xyz[2]));
    }
    reader.ReadArray(point.color.data(), 3, "a colour");
    const uint64_t error_at = reader.position();
    reader.Read<double>("an error");  // may have any value: it is recomputed
    point.error_span = {error_at, reader.position()};
    track.resize(reader.ReadCount<uint64_t>("track elements", kTrackElementSize));
    reader.ReadArray(track.data(), track.size(), "a track");
    sink->Point(point, track);
  }
  reader.ExpectEnd();
}

template <typename Sink>
void ScanTextPoints(const ModelFile& file, Sink* sink) {
  constexpr uint64_t kMaxColor = 255;
  constexpr uint64_t kMaxKeypoint = kInvalidColmapId - 1;
  ColmapTextCursor cursor(file);
  std::vector<ColmapIndex::TrackElement> track;
  while (cursor.NextRecord()) {
    ColmapPointRecord point;
    point.at = cursor.line();
    point.id = cursor.Integer("a point id", kMaxPoint3DId);
    point.xyz_span.begin = cursor.NextTokenOffset();
    point.xyz = {cursor.Number("X"), cursor.Number("Y"), cursor.Number("Z")};
    point.xyz_span.end = cursor.offset();
    for (size_t i = 0; i < 3; ++i) {
      constexpr const char* kChannels[] = {"R", "G", "B"};
      point.color[i] = static_cast<uint8_t>(cursor.Integer(kChannels[i], kMaxColor));
    }
    point.error_span.begin = cursor.NextTokenOffset();
    cursor.Number("an error");
    point.error_span.end = cursor.offset();
    track.clear();
    while (!cursor.AtEndOfLine()) {
      const uint32_t image_id = cursor.Id("an image id in the track");
      const uint64_t keypoint = cursor.Integer("a keypoint index in the track", kMaxKeypoint);
      track.push_back({image_id, static_cast<uint32_t>(keypoint)});
    }
    sink->Point(point, track);
  }
}

/// A `Sink` receives the contents of the file, in its order:
///     void Begin(uint64_t num_points, uint64_t num_bytes);   // only of a binary file
///     void Point(const ColmapPointRecord& point,
///                const std::vector<ColmapIndex::TrackElement>& track);
template <typename Sink>
void ScanPointRecords(const ModelFile& file, Sink* sink) {
  const bool is_binary = file.kind() == ModelFile::Kind::kBinary;
  is_binary ? ScanBinaryPoints(file, sink) : ScanTextPoints(file, sink);
}

}  // namespace bundle
