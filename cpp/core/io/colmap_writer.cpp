#include "core/io/colmap_writer.h"

/// Writes a COLMAP model: the files as they were read, with refined values.

#include <algorithm>
#include <array>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "core/io/colmap_byte_reader.h"
#include "core/io/colmap_file_records.h"
#include "core/io/colmap_index.h"
#include "core/io/colmap_model.h"
#include "core/io/colmap_records.h"
#include "core/io/input_file.h"
#include "core/io/output_file.h"

namespace bundle {
namespace {

/// Replaces numbers by others: in binary with the same number of bytes, in text separated by
/// blanks.
class Patcher {
 public:
  Patcher(const ModelFile& source, const std::filesystem::path& path, bool is_binary)
      : source_(source), window_(source), file_(path, Compression::kNone), is_binary_(is_binary) {}

  /// Spans must be given in the order of the file.
  void Replace(const ColmapSpan& span, const double* values, size_t count) {
    Copy(span.begin);
    for (size_t i = 0; i < count; ++i) {
      if (is_binary_) {
        buffer_.append(reinterpret_cast<const char*>(values + i), sizeof(double));
      } else {
        if (i > 0) buffer_ += ' ';
        buffer_ += FormatNumber(values[i]);
      }
    }
    position_ = span.end;
  }

  void Finish() {
    Copy(source_.size());
    Flush();
    file_.Close();
  }

 private:
  /// Copies the file up to `end`.
  void Copy(uint64_t end) {
    while (position_ < end) {
      const auto count =
          static_cast<size_t>(std::min<uint64_t>(end - position_, OutputFile::kBlockSize));
      buffer_.append(window_.At(position_, count), count);
      position_ += count;
      if (buffer_.size() >= OutputFile::kBlockSize) Flush();
    }
  }

  void Flush() {
    file_.Write(buffer_);
    buffer_.clear();
  }

  const ModelFile& source_;
  FileWindow window_;
  OutputFile file_;
  bool is_binary_;
  std::string buffer_;
  uint64_t position_ = 0;
};

/// Index of each record of the file in the problem's arrays.
std::vector<size_t> Rows(const std::vector<size_t>& by_id) {
  std::vector<size_t> rows(by_id.size());
  for (size_t row = 0; row < by_id.size(); ++row) rows[by_id[row]] = row;
  return rows;
}

/// qw qx qy qz tx ty tz of a row of the problem's arrays.
std::array<double, 7> FilePose(const double* poses, size_t row) {
  const double* pose = poses + 7 * row;
  return {pose[3], pose[0], pose[1], pose[2], pose[4], pose[5], pose[6]};
}

/// Rows of the sensors with a pose, by the positions in the file of the rig and of the sensor
/// within it.
std::map<std::pair<size_t, size_t>, size_t> SensorsInOrderOfFile(const ColmapRigs& rigs) {
  std::map<std::pair<size_t, size_t>, size_t> rows;
  for (size_t row = 0; row < rigs.sensors.size(); ++row) {
    rows.emplace(std::make_pair(rigs.sensors[row].rig, rigs.sensors[row].sensor), row);
  }
  return rows;
}

/// Rigs and frames for a model without them, as in COLMAP: one rig per camera and one frame per
/// image, with the same ids.
void WriteTrivialRigs(const ColmapModel& model, const ColmapValues& values,
                      const std::filesystem::path& folder) {
  std::vector<ColmapIndex::Rig> rigs;
  for (const size_t c : model.cameras_by_id) {
    const uint32_t id = model.index.cameras[c].id;
    rigs.push_back({id, 0, {{SensorType::kCamera, id}}, {{}}});
  }
  std::vector<ColmapIndex::Frame> frames;
  for (size_t row = 0; row < model.images_by_id.size(); ++row) {
    const ColmapIndex::Image& image = model.index.images[model.images_by_id[row]];
    const ColmapIndex::Datum datum{{SensorType::kCamera, image.camera_id}, image.id};
    frames.push_back(
        {image.id, image.camera_id, 0, {datum}, FilePose(values.cam_from_world, row), {}});
  }
  constexpr int kShortest = 0;
  WriteColmapRigs(rigs, model.is_binary(), kShortest, folder);
  WriteColmapFrames(frames, model.is_binary(), kShortest, folder);
}

/// Writes all files except the points.
void WriteViews(const ColmapModel& model, const ColmapValues& values,
                const std::filesystem::path& folder) {
  const ColmapIndex& index = model.index;
  const bool is_binary = model.is_binary();
  const char* extension = is_binary ? ".bin" : ".txt";
  const auto patcher = [&](const ModelFile& file, const char* stem) {
    return Patcher(file, folder / (std::string(stem) + extension), is_binary);
  };

  const std::vector<size_t> camera_rows = Rows(model.cameras_by_id);
  Patcher cameras = patcher(index.cameras_file, "cameras");
  for (size_t c = 0; c < index.cameras.size(); ++c) {
    cameras.Replace(index.cameras[c].params_span,
                    values.camera_params + values.params_width * camera_rows[c],
                    static_cast<size_t>(index.cameras[c].model->num_params));
  }
  cameras.Finish();

  const std::vector<size_t> image_rows = Rows(model.images_by_id);
  Patcher images = patcher(index.images_file, "images");
  for (size_t i = 0; i < index.images.size(); ++i) {
    images.Replace(index.images[i].pose_span, FilePose(values.cam_from_world, image_rows[i]).data(),
                   7);
  }
  images.Finish();

  if (!model.has_frames()) {
    WriteTrivialRigs(model, values, folder);
    return;
  }
  Patcher rigs = patcher(index.rigs_file, "rigs");
  for (const auto& [place, row] : SensorsInOrderOfFile(model.rigs)) {
    rigs.Replace(index.rigs[place.first].poses[place.second].span,
                 FilePose(values.sensor_from_rig, row).data(), 7);
  }
  rigs.Finish();

  std::vector<int64_t> frame_rows(index.frames.size(), -1);
  for (size_t row = 0; row < model.rigs.frames.size(); ++row) {
    frame_rows[model.rigs.frames[row]] = static_cast<int64_t>(row);
  }
  Patcher frames = patcher(index.frames_file, "frames");
  for (size_t f = 0; f < index.frames.size(); ++f) {
    const bool is_ours = frame_rows[f] >= 0;
    const int64_t row = is_ours ? frame_rows[f] : model.image_of_frame[f];
    if (row < 0) continue;
    const double* poses = is_ours ? values.rig_from_world : values.cam_from_world;
    frames.Replace(index.frames[f].pose_span, FilePose(poses, static_cast<size_t>(row)).data(), 7);
  }
  frames.Finish();
}

/// Writes the points while it reads them a second time.
struct RewritePoints {
  const ColmapValues& values;
  Patcher patcher;
  size_t num_points = 0;

  void Begin(uint64_t, uint64_t) const {}
  void Point(const ColmapPointRecord& point, const std::vector<ColmapIndex::TrackElement>&) {
    if (num_points == values.num_points) FailAsChanged();
    const int64_t* const end = values.point_ids + values.num_points;
    const auto id = static_cast<int64_t>(point.id);
    const int64_t* found = values.point_ids + num_points++;
    if (*found != id) found = std::lower_bound(values.point_ids, end, id);  // not ordered by id
    if (found == end || *found != id) FailAsChanged();
    const auto row = static_cast<size_t>(found - values.point_ids);
    patcher.Replace(point.xyz_span, values.points + 3 * row, 3);
    patcher.Replace(point.error_span, values.point_errors + row, 1);
  }
};

}  // namespace

void WriteColmapModel(const ColmapModel& model, const ColmapValues& values,
                      const std::filesystem::path& folder) {
  WriteViews(model, values, folder);
  const bool is_binary = model.is_binary();
  const ModelFile& file = model.index.points_file;
  const char* name = is_binary ? "points3D.bin" : "points3D.txt";
  RewritePoints sink{values, Patcher(file, folder / name, is_binary)};
  ScanPointRecords(file, &sink);
  if (sink.num_points != values.num_points) FailAsChanged();
  sink.patcher.Finish();
}

}  // namespace bundle
