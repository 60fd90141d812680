#pragma once

/// Contents of the files of a COLMAP model, and checks of their values.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <string_view>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/io/marked_keypoints.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// One file of a model, in memory or open as a stream, and its name for error messages.
class ModelFile {
 public:
  enum class Kind { kText, kBinary };

  /// Size of the largest file that the constructor reads into memory.
  static constexpr size_t kLargestInMemory = size_t{4} << 20;

  ModelFile() = default;

  /// Reads a small file into memory, so that later changes on the disk have no effect. Opens a
  /// larger file as a stream: its bytes take more memory than the arrays of its problem. A stream
  /// reads the same file even if its name is given to another one.
  ///
  /// Throws InputError if the file cannot be opened, is not a regular file or cannot be read.
  ModelFile(std::string path, Kind kind);

  /// Opens a file of any size as a stream. `on_block` is called before each read and may throw.
  /// Throws InputError as the constructor.
  static ModelFile Stream(std::string path, Kind kind, std::function<void()> on_block);

  const std::string& path() const { return path_; }
  Kind kind() const { return kind_; }
  uint64_t size() const { return size_; }
  bool is_stream() const { return descriptor_ != nullptr; }

  /// Contents of a file in memory; empty for a stream.
  std::string_view contents() const { return {contents_.get(), is_stream() ? 0 : size_}; }

  /// Reads bytes of the file. Throws InputError if a stream cannot be read, or has changed since it
  /// was opened.
  void ReadAt(uint64_t position, char* buffer, size_t count) const;

  /// True if a stream was written to after it was opened.
  bool has_changed() const;

  /// Message of the error that `Fail` throws.
  std::string Complaint(uint64_t position, const std::string& message) const;

  /// Throws InputError "PATH:POSITION: message" (a line, counted from 1) for text and
  /// "PATH: byte POSITION: message" (an offset, counted from 0) for binary.
  [[noreturn]] void Fail(uint64_t position, const std::string& message) const;

 private:
  std::string path_;
  Kind kind_ = Kind::kText;
  std::unique_ptr<char[]> contents_;
  size_t size_ = 0;
  std::shared_ptr<const int> descriptor_;  ///< descriptor of a stream
  int64_t changed_at_ = 0;                 ///< time of the last change of a stream, in nanoseconds
  std::function<void()> on_block_;
};

// COLMAP's kInvalid*Id: marks a missing reference; not a valid id of a record.
constexpr uint32_t kInvalidColmapId = std::numeric_limits<uint32_t>::max();
constexpr uint64_t kInvalidPoint3DId = std::numeric_limits<uint64_t>::max();

/// Upper limit of point ids: text files and the problem's arrays store them as signed 64-bit
/// numbers.
constexpr uint64_t kMaxPoint3DId = std::numeric_limits<int64_t>::max();

// Bytes in binary files: a keypoint, a track element, and the part of a point before its track.
constexpr uint64_t kKeypointSize = 24;
constexpr uint64_t kTrackElementSize = 8;
constexpr uint64_t kPointRecordSize = 8 + 24 + 3 + 8 + 8;

/// COLMAP's SensorType.
enum class SensorType : int32_t { kCamera = 0, kImu = 1 };

/// The bytes from `begin` up to `end` of a file.
struct ColmapSpan {
  uint64_t begin = 0;
  uint64_t end = 0;
};

/// Contents of the files of a COLMAP model: all ids, references and their positions, and the values
/// that a solve changes. The scanners of the text and of the binary format fill it and check single
/// values; CheckColmapReferences checks the references.
///
/// `at` is the position of a record: its line in a text file, its first byte in a binary one. A
/// span contains the numbers that `colmap_writer.h` replaces. Poses are qw qx qy qz tx ty tz, as in
/// the files.
struct ColmapIndex {
  struct Sensor {
    SensorType type;
    uint32_t id;
    bool operator==(const Sensor& other) const { return type == other.type && id == other.id; }
  };
  struct Camera {
    uint32_t id = 0;
    uint64_t at = 0;
    const CameraModel* model = nullptr;
    uint64_t width = 0;
    uint64_t height = 0;
    std::array<double, kMaxCameraParams> params{};
    ColmapSpan params_span;
  };
  /// sensor_from_rig, if it is known.
  struct SensorPose {
    bool is_known = false;
    std::array<double, 7> pose{};
    ColmapSpan span{};
  };
  struct Rig {
    uint32_t id;
    uint64_t at;
    std::vector<Sensor> sensors{};    ///< the reference sensor first
    std::vector<SensorPose> poses{};  ///< pose per sensor; unknown for the reference sensor
  };
  struct Datum {
    Sensor sensor;
    uint64_t id;
  };
  struct Frame {
    uint32_t id;
    uint32_t rig_id;
    uint64_t at;
    std::vector<Datum> data;
    std::array<double, 7> pose{};
    ColmapSpan pose_span{};
  };
  struct Image {
    uint32_t id;
    uint32_t camera_id;
    uint64_t at;
    uint64_t keypoints_at;    ///< position of the first keypoint in the file
    uint64_t first_keypoint;  ///< index in `keypoints`
    uint64_t num_keypoints;
    std::string name{};
    std::array<double, 7> pose{};
    ColmapSpan pose_span{};
  };
  struct Point {
    uint64_t id;
    uint64_t at;
    uint64_t first_element;  ///< index in track_elements
    std::array<double, 3> xyz{};
  };
  struct TrackElement {
    uint32_t image_id;
    uint32_t keypoint;
  };

  ModelFile rigs_file, cameras_file, frames_file, images_file, points_file;
  std::vector<Rig> rigs;
  std::vector<Camera> cameras;
  std::vector<Frame> frames;
  std::vector<Image> images;
  MarkedKeypoints keypoints;             ///< marked: the keypoint has a point
  std::vector<uint64_t> seen_point_ids;  ///< point id of each marked keypoint
  std::vector<double> seen_xy;           ///< x, y of each marked keypoint
  std::vector<Point> points;
  std::vector<TrackElement> track_elements;  ///< track elements of all points

  ModelFile::Kind kind = ModelFile::Kind::kText;

  uint64_t KeypointPlace(const Image& image, uint64_t keypoint) const;
  uint64_t TrackElementPlace(const Point& point, uint64_t element) const;
};

/// Positions of the records in the order of their ids, the order of the problem's arrays.
template <typename Record>
std::vector<size_t> OrderById(const std::vector<Record>& records) {
  std::vector<size_t> order(records.size());
  std::iota(order.begin(), order.end(), size_t{0});
  const auto before = [&](size_t a, size_t b) { return records[a].id < records[b].id; };
  if (!std::is_sorted(order.begin(), order.end(), before)) {
    std::sort(order.begin(), order.end(), before);
  }
  return order;
}

/// Model of a COLMAP id; nullptr if COLMAP 4.2 has no such model. The models of the registry are in
/// the order of COLMAP's ids.
const CameraModel* FindColmapCameraModel(int32_t id);

// Checks of single values, the same in both formats. Each function throws InputError at `position`;
// `subject` is, for example, "camera 3".

/// Checks that parameters are finite, and focal lengths and image sizes above zero.
void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const CameraModel& model, const double* params);

/// Checks a pose, qw qx qy qz tx ty tz as in the files: its numbers are finite and its quaternion
/// gives a rotation.
void CheckPose(const ModelFile& file, uint64_t position, const std::string& subject,
               const double* pose);

/// Image sizes must fit signed 64-bit numbers.
void CheckCameraSize(const ModelFile& file, uint64_t position, const std::string& subject,
                     uint64_t width, uint64_t height);

/// Checks that an image name is UTF-8 without control characters, as pycolmap needs.
void CheckImageName(const ModelFile& file, uint64_t position, const std::string& subject,
                    std::string_view name);

/// "camera 3".
inline std::string RecordName(const char* kind, uint64_t id) {
  return kind + (" " + std::to_string(id));
}

/// The shortest decimal number that reads back as `value`.
std::string FormatNumber(double value);

/// The observations of a model, as in a problem: images and points are numbered in the order of
/// their ids, the rows sorted by point, then image, then keypoint.
struct ColmapObservations {
  LargeVector<int32_t> image;
  LargeVector<int32_t> point;
  LargeVector<int32_t> keypoint;
  LargeVector<double> xy;  ///< two per row
};

/// `point_of_seen` is what CheckColmapReferences returned for this index.
ColmapObservations SortColmapObservations(const ColmapIndex& index,
                                          const std::vector<int32_t>& point_of_seen);

}  // namespace bundle
