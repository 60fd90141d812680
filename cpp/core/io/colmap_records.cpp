#include "core/io/colmap_records.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>
#include <utility>

#include "core/cameras/camera_model.h"
#include "core/cameras/registry.h"
#include "core/io/colmap_binary_records.h"
#include "core/io/files.h"
#include "core/io/text_cursor.h"

namespace bundle {
namespace {

/// One file of a model: values one after the other, in either format. Text separates them by
/// blanks and has no counts but in its comments.
class RecordFile {
 public:
  /// `comments`: the lines at the head of text; without "#" and the line end of the last.
  RecordFile(const std::filesystem::path& folder, const char* stem, bool is_binary, int digits,
             std::string_view comments, size_t count, std::function<void()> on_block = {})
      : file_(folder / (std::string(stem) + (is_binary ? ".bin" : ".txt")), Compression::kNone),
        is_binary_(is_binary),
        digits_(digits),
        on_block_(std::move(on_block)) {
    if (is_binary) {
      Raw(static_cast<uint64_t>(count));
    } else {
      buffer_.append(comments).append(std::to_string(count));
    }
  }

  /// ", WORDS: MEAN" behind the count of text.
  void Mean(const char* words, size_t sum, size_t count) {
    if (is_binary_) return;
    buffer_.append(words);
    AppendNumber(count == 0 ? 0.0 : static_cast<double>(sum) / static_cast<double>(count));
  }

  void BeginRecord() {
    if (buffer_.size() >= OutputFile::kBlockSize) Flush();
    EndLine();
  }

  /// In text, the next values stand in a line of their own.
  void EndLine() {
    if (!is_binary_) buffer_ += '\n';
    at_begin_of_line_ = true;
  }

  template <typename T>
  void Integer(T value) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      char text[24];
      buffer_.append(text, std::to_chars(text, text + sizeof(text), +value).ptr);
    }
  }

  void Number(double value) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      AppendNumber(value);
    }
  }

  /// qw qx qy qz tx ty tz.
  void Pose(const std::array<double, 7>& pose) {
    for (const double value : pose) Number(value);
  }

  /// A number in binary, a word in text.
  template <typename T>
  void Named(T value, std::string_view name) {
    if (is_binary_) {
      Raw(value);
    } else {
      Separate();
      buffer_.append(name);
    }
  }

  void Sensor(const ColmapIndex::Sensor& sensor) {
    Named(static_cast<int32_t>(sensor.type), sensor.type == SensorType::kCamera ? "CAMERA" : "IMU");
    Integer(sensor.id);
  }

  void Name(const std::string& name) {
    if (!is_binary_) Separate();
    buffer_.append(name);
    if (is_binary_) buffer_ += '\0';
  }

  /// What text does not count.
  template <typename T>
  void BinaryCount(T count) {
    if (is_binary_) Raw(count);
  }

  /// COLMAP's text has a blank here, whether anything follows or not.
  void Blank() {
    if (is_binary_) return;
    buffer_ += ' ';
    at_begin_of_line_ = true;
  }

  /// Between blocks, once there is one.
  void MayFlush() {
    if (buffer_.size() >= OutputFile::kBlockSize) Flush();
  }

  void Close() {
    if (!is_binary_) buffer_ += '\n';
    Flush();
    file_.Close();
  }

 private:
  template <typename T>
  void Raw(T value) {
    buffer_.append(reinterpret_cast<const char*>(&value), sizeof(T));
  }

  void Separate() {
    if (!at_begin_of_line_) buffer_ += ' ';
    at_begin_of_line_ = false;
  }

  void AppendNumber(double value) {
    char text[40];
    char* const end = text + sizeof(text);
    const auto result = digits_ == 0
                            ? std::to_chars(text, end, value)
                            : std::to_chars(text, end, value, std::chars_format::general, digits_);
    buffer_.append(text, result.ptr);
  }

  void Flush() {
    if (on_block_) on_block_();
    file_.Write(buffer_);
    buffer_.clear();
  }

  OutputFile file_;
  bool is_binary_;
  int digits_;
  std::function<void()> on_block_;
  std::string buffer_;
  bool at_begin_of_line_ = true;
};

/// COLMAP writes so many digits.
constexpr int kDigits = 17;

void WriteCameras(const ColmapRecords& records, bool is_binary,
                  const std::filesystem::path& folder) {
  RecordFile file(folder, "cameras", is_binary, kDigits,
                  "# Camera list with one line of data per camera:\n"
                  "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
                  "# Number of cameras: ",
                  records.cameras.size());
  for (const ColmapIndex::Camera& camera : records.cameras) {
    file.BeginRecord();
    file.Integer(camera.id);
    file.Named(static_cast<int32_t>(camera.model - AllCameraModels()), camera.model->name);
    file.Integer(camera.width);
    file.Integer(camera.height);
    for (int i = 0; i < camera.model->num_params; ++i) {
      file.Number(camera.params[static_cast<size_t>(i)]);
    }
  }
  file.Close();
}

void WriteImages(const ColmapRecords& records, bool is_binary, const std::filesystem::path& folder,
                 size_t num_observations, const std::function<void()>& on_block) {
  RecordFile file(folder, "images", is_binary, kDigits,
                  "# Image list with two lines of data per image:\n"
                  "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                  "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
                  "# Number of images: ",
                  records.images.size(), on_block);
  file.Mean(", mean observations per image: ", num_observations, records.images.size());
  for (const ColmapIndex::Image& image : records.images) {
    file.BeginRecord();
    file.Integer(image.id);
    file.Pose(image.pose);
    file.Integer(image.camera_id);
    file.Name(image.name);
    file.BinaryCount(image.num_keypoints);
    file.EndLine();
    const uint64_t end = image.first_keypoint + image.num_keypoints;
    for (uint64_t k = image.first_keypoint; k < end; ++k) {
      file.MayFlush();
      file.Number(records.keypoint_xy[2 * k]);
      file.Number(records.keypoint_xy[2 * k + 1]);
      const uint64_t point = records.keypoint_points[k];
      if (point == kInvalidPoint3DId) {
        file.Named(point, "-1");
      } else {
        file.Integer(point);
      }
    }
    if (image.num_keypoints > 0) file.Blank();
  }
  file.Close();
}

/// v turned by the quaternion qw qx qy qz as it is, norm 1 or not, and shifted: the same operations
/// in the same order as COLMAP's (Eigen's).
std::array<double, 3> ToCamera(const std::array<double, 7>& pose, const double* v) {
  const double w = pose[0], x = pose[1], y = pose[2], z = pose[3];
  const double twice[3] = {2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]),
                           2 * (x * v[1] - y * v[0])};
  return {v[0] + w * twice[0] + (y * twice[2] - z * twice[1]) + pose[4],
          v[1] + w * twice[1] + (z * twice[0] - x * twice[2]) + pose[5],
          v[2] + w * twice[2] + (x * twice[1] - y * twice[0]) + pose[6]};
}

/// The cameras of images, by the position of the image.
std::vector<const ColmapIndex::Camera*> CamerasOfImages(const ColmapRecords& records) {
  std::vector<const ColmapIndex::Camera*> cameras;
  for (const ColmapIndex::Image& image : records.images) {
    cameras.push_back(&*std::lower_bound(
        records.cameras.begin(), records.cameras.end(), image.camera_id,
        [](const ColmapIndex::Camera& camera, uint32_t id) { return camera.id < id; }));
  }
  return cameras;
}

double ErrorOf(const ColmapIndex::Image& image, const ColmapIndex::Camera& camera,
               const double* point, const double* measurement) {
  const std::array<double, 3> in_camera = ToCamera(image.pose, point);
  double xy[2];
  const Projection projection =
      camera.model->project(camera.params.data(), in_camera.data(), xy, nullptr, nullptr);
  if (projection != Projection::kValid) return std::sqrt(std::numeric_limits<double>::max());
  const double dx = xy[0] - measurement[0], dy = xy[1] - measurement[1];
  return std::sqrt(dx * dx + dy * dy);
}

void WritePoints(const ColmapRecords& records, bool is_binary, const std::filesystem::path& folder,
                 size_t num_observations, const std::function<void()>& on_block) {
  const std::vector<const ColmapIndex::Camera*> cameras = CamerasOfImages(records);
  RecordFile file(folder, "points3D", is_binary, kDigits,
                  "# 3D point list with one line of data per point:\n"
                  "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
                  "# Number of points: ",
                  records.num_points, on_block);
  file.Mean(", mean track length: ", num_observations, records.num_points);
  size_t begin = 0;
  for (size_t p = 0; p < records.num_points; ++p) {
    const double* point = records.points + 3 * p;
    const size_t end = begin + static_cast<size_t>(records.track_lengths[p]);
    double error = begin == end ? -1.0 : 0.0;
    for (size_t e = begin; e < end; ++e) {
      const auto i = static_cast<size_t>(records.track_images[e]);
      const ColmapIndex::Image& image = records.images[i];
      const uint64_t k = image.first_keypoint + static_cast<uint64_t>(records.track_keypoints[e]);
      error += ErrorOf(image, *cameras[i], point, records.keypoint_xy + 2 * k);
    }
    if (begin != end) error /= static_cast<double>(end - begin);

    file.BeginRecord();
    file.Integer(static_cast<uint64_t>(records.point_ids[p]));
    for (int i = 0; i < 3; ++i) file.Number(point[i]);
    for (int i = 0; i < 3; ++i) file.Integer(records.point_colors[3 * p + static_cast<size_t>(i)]);
    file.Number(is_binary || std::isfinite(error) ? error : -1.0);
    file.Blank();
    file.BinaryCount(static_cast<uint64_t>(end - begin));
    for (size_t e = begin; e < end; ++e) {
      file.Integer(records.images[static_cast<size_t>(records.track_images[e])].id);
      file.Integer(static_cast<uint32_t>(records.track_keypoints[e]));
    }
    begin = end;
  }
  file.Close();
}

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

void WriteColmapRigs(const std::vector<ColmapIndex::Rig>& rigs, bool is_binary, int digits,
                     const std::filesystem::path& folder) {
  RecordFile file(folder, "rigs", is_binary, digits,
                  "# Rig calib list with one line of data per calib:\n"
                  "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
                  "(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n"
                  "# Number of rigs: ",
                  rigs.size());
  for (const ColmapIndex::Rig& rig : rigs) {
    file.BeginRecord();
    file.Integer(rig.id);
    file.Integer(static_cast<uint32_t>(rig.sensors.size()));
    for (size_t s = 0; s < rig.sensors.size(); ++s) {
      file.Sensor(rig.sensors[s]);
      if (s == 0) continue;
      file.Integer(static_cast<uint8_t>(rig.poses[s].is_known));
      if (rig.poses[s].is_known) file.Pose(rig.poses[s].pose);
    }
  }
  file.Close();
}

void WriteColmapFrames(const std::vector<ColmapIndex::Frame>& frames, bool is_binary, int digits,
                       const std::filesystem::path& folder) {
  RecordFile file(folder, "frames", is_binary, digits,
                  "# Frame list with one line of data per frame:\n"
                  "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], "
                  "NUM_DATA_IDS, DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n"
                  "# Number of frames: ",
                  frames.size());
  for (const ColmapIndex::Frame& frame : frames) {
    file.BeginRecord();
    file.Integer(frame.id);
    file.Integer(frame.rig_id);
    file.Pose(frame.pose);
    file.Integer(static_cast<uint32_t>(frame.data.size()));
    for (const ColmapIndex::Datum& datum : frame.data) {
      file.Sensor(datum.sensor);
      file.Integer(datum.id);
    }
  }
  file.Close();
}

void WriteColmapRecords(const ColmapRecords& records, bool is_binary,
                        const std::filesystem::path& folder,
                        const std::function<void()>& on_block) {
  size_t num_observations = 0;
  for (size_t p = 0; p < records.num_points; ++p) {
    num_observations += static_cast<size_t>(records.track_lengths[p]);
  }
  WriteColmapRigs(records.rigs, is_binary, kDigits, folder);
  WriteCameras(records, is_binary, folder);
  WriteColmapFrames(records.frames, is_binary, kDigits, folder);
  WriteImages(records, is_binary, folder, num_observations, on_block);
  WritePoints(records, is_binary, folder, num_observations, on_block);
}

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
