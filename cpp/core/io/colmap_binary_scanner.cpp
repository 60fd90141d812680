#include "core/io/colmap_binary_scanner.h"

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

#include <string>
#include <utility>
#include <vector>

#include "core/cameras/registry.h"
#include "core/io/colmap_byte_reader.h"
#include "core/io/colmap_index.h"

namespace bundle {
namespace {

// Bytes of the smallest possible record of each kind.
constexpr uint64_t kMinCameraSize = 24 + 2 * 8;
constexpr uint64_t kMinRigSize = 8;
constexpr uint64_t kMinFrameSize = 8 + 56 + 4;
constexpr uint64_t kDatumSize = 16;
constexpr uint64_t kMinSensorSize = 9;

ColmapIndex::Sensor ReadSensor(ByteReader* reader, const ModelFile& file,
                               const std::string& subject) {
  const uint64_t at = reader->position();
  const auto type = reader->Read<int32_t>("a sensor type");
  if (type != static_cast<int32_t>(SensorType::kCamera) &&
      type != static_cast<int32_t>(SensorType::kImu)) {
    file.Fail(at, subject + ": expected sensor type 0 (camera) or 1 (IMU), found " +
                      std::to_string(type));
  }
  return {static_cast<SensorType>(type), reader->ReadId("a sensor id")};
}

void ScanCameras(ColmapIndex* index) {
  ByteReader reader(index->cameras_file);
  const auto count = reader.ReadCount<uint64_t>("cameras", kMinCameraSize);
  index->cameras.reserve(count);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = reader.ReadId("a camera id");
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

void ScanRigs(ColmapIndex* index) {
  ByteReader reader(index->rigs_file);
  const auto count = reader.ReadCount<uint64_t>("rigs", kMinRigSize);
  index->rigs.reserve(count);
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t at = reader.position();
    const uint32_t id = reader.ReadId("a rig id");
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
    const uint32_t id = reader.ReadId("a frame id");
    const std::string subject = "frame " + std::to_string(id);
    const uint32_t rig_id = reader.ReadId("a rig id");
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

const ColmapScanner kColmapBinaryScanner = {ModelFile::Kind::kBinary, ".bin", ScanRigs, ScanCameras,
                                            ScanFrames};

}  // namespace bundle
