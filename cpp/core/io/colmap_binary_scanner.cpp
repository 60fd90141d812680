// COLMAP's binary format, little-endian without padding:
//
//   cameras.bin   u64 count; u32 id, i32 model, u64 width, u64 height, f64 params[]
//   images.bin    u64 count; u32 id, f64 qw qx qy qz tx ty tz, u32 camera, name '\0',
//                 u64 count; f64 x y, u64 point (2^64-1: none)
//   points3D.bin  u64 count; u64 id, f64 xyz[3], u8 rgb[3], f64 error, u64 count; u32 image,
//                 u32 keypoint
//   rigs.bin      u64 count; u32 id, u32 count; i32 type, u32 sensor (the reference sensor), then
//                 of each other: i32 type, u32 sensor, u8 has_pose, f64 qw qx qy qz tx ty tz if so
//   frames.bin    u64 count; u32 id, u32 rig, f64 qw qx qy qz tx ty tz, u32 count;
//                 i32 type, u32 sensor, u64 datum
//
// Every count is held against what is left of the file before anything is allocated or read.

#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include "core/cameras/registry.h"
#include "core/io/colmap_index.h"

namespace bundle {
namespace {

// Bytes of the smallest possible record of each kind.
constexpr uint64_t kMinCameraSize = 24 + 2 * 8;
constexpr uint64_t kMinImageSize = 4 + 56 + 4 + 1 + 8;
constexpr uint64_t kMinRigSize = 8;
constexpr uint64_t kMinFrameSize = 8 + 56 + 4;
constexpr uint64_t kDatumSize = 16;
constexpr uint64_t kMinSensorSize = 9;

class ByteReader {
 public:
  explicit ByteReader(const ModelFile& file) : file_(file), contents_(file.contents()) {}

  uint64_t position() const { return position_; }
  uint64_t num_left() const { return contents_.size() - position_; }

  /// The value under the cursor; `what` names it when the file ends before it.
  template <typename T>
  T Read(const char* what) {
    T value;
    ReadArray(&value, 1, what);
    return value;
  }

  template <typename T>
  void ReadArray(T* values, size_t count, const char* what) {
    if (num_left() < count * sizeof(T)) {
      Fail(std::string("expected ") + what + " (" + std::to_string(count * sizeof(T)) +
           " bytes), found the end of the file after " + std::to_string(num_left()));
    }
    std::memcpy(values, contents_.data() + position_, count * sizeof(T));
    position_ += count * sizeof(T);
  }

  /// A count of records that each take `min_size` bytes at least.
  template <typename T>
  T ReadCount(const std::string& what, uint64_t min_size) {
    const uint64_t at = position_;
    const T count = Read<T>(("the number of " + what).c_str());
    if (count > num_left() / min_size) {
      file_.Fail(at, "expected at most " + std::to_string(num_left() / min_size) + " " + what +
                         " in the " + std::to_string(num_left()) + " bytes that follow, found " +
                         std::to_string(count));
    }
    return count;
  }

  std::string_view ReadName(const std::string& subject) {
    const size_t end = contents_.find('\0', position_);
    if (end == std::string_view::npos) {
      Fail(subject + ": expected a name that ends in a zero byte, found the end of the file");
    }
    const std::string_view name = contents_.substr(position_, end - position_);
    position_ = end + 1;
    return name;
  }

  void ExpectEnd() const {
    if (num_left() == 0) return;
    Fail("expected the end of the file, found " + std::to_string(num_left()) + " more bytes");
  }

  [[noreturn]] void Fail(const std::string& message) const { file_.Fail(position_, message); }

 private:
  const ModelFile& file_;
  std::string_view contents_;
  uint64_t position_ = 0;
};

uint32_t ReadId(ByteReader* reader, const ModelFile& file, const char* what) {
  const uint64_t at = reader->position();
  const auto id = reader->Read<uint32_t>(what);
  if (id != kInvalidColmapId) return id;
  file.Fail(at, std::string("expected ") + what + " below 4294967295, found " + std::to_string(id));
}

ColmapIndex::Sensor ReadSensor(ByteReader* reader, const ModelFile& file,
                               const std::string& subject) {
  const uint64_t at = reader->position();
  const auto type = reader->Read<int32_t>("a sensor type");
  if (type != static_cast<int32_t>(SensorType::kCamera) &&
      type != static_cast<int32_t>(SensorType::kImu)) {
    file.Fail(at, subject + ": expected sensor type 0 (camera) or 1 (IMU), found " +
                      std::to_string(type));
  }
  return {static_cast<SensorType>(type), ReadId(reader, file, "a sensor id")};
}

void ScanCameras(ColmapIndex* index) {
  ByteReader reader(index->cameras_file);
  const auto count = reader.ReadCount<uint64_t>("cameras", kMinCameraSize);
  index->cameras.reserve(count);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = ReadId(&reader, index->cameras_file, "a camera id");
    const std::string subject = "camera " + std::to_string(id);
    const auto model_id = reader.Read<int32_t>("a camera model id");
    const CameraModel* model = FindColmapCameraModel(model_id);
    if (model == nullptr) {
      index->cameras_file.Fail(at + 4, subject + ": expected a camera model id from 0 to " +
                                           std::to_string(kNumCameraModels - 1) + ", found " +
                                           std::to_string(model_id));
    }
    const auto width = reader.Read<uint64_t>("an image width");
    const auto height = reader.Read<uint64_t>("an image height");
    CheckCameraSize(index->cameras_file, at + 8, subject, width, height);
    ColmapIndex::Camera camera{id, at, model, width, height, {}, {}};
    reader.ReadArray(camera.params.data(), static_cast<size_t>(model->num_params),
                     "camera parameters");
    camera.params_span = {at + 24, reader.position()};
    CheckCameraParams(index->cameras_file, at + 24, subject, *model, camera.params.data());
    index->cameras.push_back(camera);
  }
  reader.ExpectEnd();
}

void ScanKeypoints(ColmapIndex* index, ByteReader* reader, const std::string& subject) {
  const auto count = reader->ReadCount<uint64_t>("keypoints of " + subject, kKeypointSize);
  ColmapIndex::Image& image = index->images.back();
  image.keypoints_at = reader->position();
  image.num_keypoints = count;
  for (uint64_t k = 0; k < count; ++k) {
    double xy[2];
    reader->ReadArray(xy, 2, "a keypoint");
    if (!std::isfinite(xy[0]) || !std::isfinite(xy[1])) {
      index->images_file.Fail(index->KeypointPlace(image, k),
                              subject + ", keypoint " + std::to_string(k) +
                                  ": expected finite coordinates, found " + FormatNumber(xy[0]) +
                                  " " + FormatNumber(xy[1]));
    }
    const auto point_id = reader->Read<uint64_t>("a point id");
    index->keypoint_point_ids.push_back(point_id);
    if (point_id == kInvalidPoint3DId) continue;
    index->triangulated_xy.insert(index->triangulated_xy.end(), {xy[0], xy[1]});
  }
}

void ScanImages(ColmapIndex* index) {
  ByteReader reader(index->images_file);
  const auto count = reader.ReadCount<uint64_t>("images", kMinImageSize);
  index->images.reserve(count);
  index->keypoint_point_ids.reserve(reader.num_left() / kKeypointSize);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = ReadId(&reader, index->images_file, "an image id");
    const std::string subject = "image " + std::to_string(id);
    std::array<double, 7> pose;
    reader.ReadArray(pose.data(), 7, "a pose");
    CheckPose(index->images_file, at + 4, subject, pose.data());
    const ColmapSpan pose_span{at + 4, reader.position()};
    const uint32_t camera_id = ReadId(&reader, index->images_file, "a camera id");
    const uint64_t name_at = reader.position();
    const std::string_view name = reader.ReadName(subject);
    CheckImageName(index->images_file, name_at, subject, name);
    index->images.push_back({id, camera_id, at, 0, index->keypoint_point_ids.size(), 0,
                             std::string(name), pose, pose_span});
    ScanKeypoints(index, &reader, subject);
  }
  reader.ExpectEnd();
}

void ScanPoints(ColmapIndex* index) {
  ByteReader reader(index->points_file);
  const auto count = reader.ReadCount<uint64_t>("points", kPointRecordSize);
  index->points.reserve(count);
  index->track_elements.reserve((reader.num_left() - count * kPointRecordSize) / kTrackElementSize);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const auto id = reader.Read<uint64_t>("a point id");
    if (id > kMaxPoint3DId) {
      index->points_file.Fail(at, "expected a point id below 2^63, found " + std::to_string(id));
    }
    std::array<double, 3> xyz;
    reader.ReadArray(xyz.data(), 3, "a position");
    const ColmapSpan xyz_span{at + 8, reader.position()};
    if (!std::isfinite(xyz[0]) || !std::isfinite(xyz[1]) || !std::isfinite(xyz[2])) {
      index->points_file.Fail(at + 8, "point " + std::to_string(id) +
                                          ": expected a finite position, found " +
                                          FormatNumber(xyz[0]) + " " + FormatNumber(xyz[1]) + " " +
                                          FormatNumber(xyz[2]));
    }
    uint8_t rgb[3];
    reader.ReadArray(rgb, 3, "a colour");
    const uint64_t error_at = reader.position();
    reader.Read<double>("an error");  // may be anything: it is computed anew
    const ColmapSpan error_span{error_at, reader.position()};
    const auto length = reader.ReadCount<uint64_t>("track elements", kTrackElementSize);
    const size_t first_element = index->track_elements.size();
    index->points.push_back({id, at, first_element, xyz, xyz_span, error_span});
    index->track_elements.resize(first_element + length);
    reader.ReadArray(index->track_elements.data() + first_element, length, "a track");
  }
  reader.ExpectEnd();
}

void ScanRigs(ColmapIndex* index) {
  ByteReader reader(index->rigs_file);
  const auto count = reader.ReadCount<uint64_t>("rigs", kMinRigSize);
  index->rigs.reserve(count);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = ReadId(&reader, index->rigs_file, "a rig id");
    const std::string subject = "rig " + std::to_string(id);
    const auto num_sensors =
        reader.ReadCount<uint32_t>("sensors of " + subject, kMinSensorSize - 1);
    ColmapIndex::Rig rig{id, at};
    for (uint32_t j = 0; j < num_sensors; ++j) {
      rig.sensors.push_back(ReadSensor(&reader, index->rigs_file, subject));
      ColmapIndex::SensorPose& sensor = rig.poses.emplace_back();
      if (j == 0 || reader.Read<uint8_t>("a pose flag") == 0) continue;  // first: reference sensor
      const uint64_t pose_at = reader.position();
      reader.ReadArray(sensor.pose.data(), 7, "a pose");
      CheckPose(index->rigs_file, pose_at, subject + ", sensor " + std::to_string(j),
                sensor.pose.data());
      sensor.is_known = true;
      sensor.span = {pose_at, reader.position()};
    }
    index->rigs.push_back(std::move(rig));
  }
  reader.ExpectEnd();
}

void ScanFrames(ColmapIndex* index) {
  ByteReader reader(index->frames_file);
  const auto count = reader.ReadCount<uint64_t>("frames", kMinFrameSize);
  index->frames.reserve(count);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = ReadId(&reader, index->frames_file, "a frame id");
    const std::string subject = "frame " + std::to_string(id);
    const uint32_t rig_id = ReadId(&reader, index->frames_file, "a rig id");
    ColmapIndex::Frame frame{id, rig_id, at, {}};
    reader.ReadArray(frame.pose.data(), 7, "a pose");
    CheckPose(index->frames_file, at + 8, subject, frame.pose.data());
    frame.pose_span = {at + 8, reader.position()};
    const auto num_data = reader.ReadCount<uint32_t>("data of " + subject, kDatumSize);
    for (uint32_t j = 0; j < num_data; ++j) {
      const ColmapIndex::Sensor sensor = ReadSensor(&reader, index->frames_file, subject);
      frame.data.push_back({sensor, reader.Read<uint64_t>("a datum id")});
    }
    index->frames.push_back(std::move(frame));
  }
  reader.ExpectEnd();
}

}  // namespace

const ColmapScanner kColmapBinaryScanner = {
    ModelFile::Kind::kBinary, ".bin", ScanRigs, ScanCameras, ScanFrames, ScanImages, ScanPoints};

}  // namespace bundle
