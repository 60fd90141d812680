#include "core/io/colmap_model.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>

#include "core/cameras/registry.h"
#include "core/error.h"
#include "core/io/colmap_checker.h"
#include "core/io/colmap_index.h"
#include "core/io/input_file.h"
#include "core/io/printable.h"

namespace bundle {

namespace {

void PutPose(const std::array<double, 7>& pose, double* row) {
  std::copy_n(pose.begin() + 1, 3, row);
  row[3] = pose[0];
  std::copy_n(pose.begin() + 4, 3, row + 4);
}

}  // namespace

std::vector<double> ColmapModel::RigFromWorld() const {
  std::vector<double> poses(7 * rigs.frames.size());
  for (size_t row = 0; row < rigs.frames.size(); ++row) {
    PutPose(index.frames[rigs.frames[row]].pose, poses.data() + 7 * row);
  }
  return poses;
}

std::vector<double> ColmapModel::SensorFromRig() const {
  std::vector<double> poses(7 * rigs.sensors.size());
  for (size_t row = 0; row < rigs.sensors.size(); ++row) {
    const auto [rig, sensor] = rigs.sensors[row];
    PutPose(index.rigs[rig].poses[sensor].pose, poses.data() + 7 * row);
  }
  return poses;
}

std::vector<double> ColmapModel::ImagePoses() const {
  std::vector<double> poses(7 * index.images.size());
  for (size_t row = 0; row < images_by_id.size(); ++row) {
    PutPose(index.images[images_by_id[row]].pose, poses.data() + 7 * row);
  }
  return poses;
}

std::vector<double> ColmapModel::CamFromWorld() const {
  std::vector<double> poses = ImagePoses();
  for (size_t f = 0; f < index.frames.size(); ++f) {
    if (image_of_frame[f] < 0) continue;
    PutPose(index.frames[f].pose, poses.data() + 7 * image_of_frame[f]);
  }
  return poses;
}

namespace {

/// Frees the memory of a vector. An assignment of {} would keep it.
template <typename T>
void Free(std::vector<T>* values) {
  std::vector<T>().swap(*values);
}

}  // namespace

ColmapModel ReadColmapModel(const std::string& folder, bool may_be_empty) {
  ColmapModel model;
  ColmapIndex& index = model.index;
  index = ScanColmapModel(folder);
  const std::vector<int32_t> point_of_seen = CheckColmapReferences(index, may_be_empty);
  Free(&index.seen_point_ids);  // early: what follows needs the most memory
  Free(&index.track_elements);
  model.cameras_by_id = OrderById(index.cameras);
  model.images_by_id = OrderById(index.images);
  FindColmapRigs(&model);
  model.observations = SortColmapObservations(index, point_of_seen);
  index.keypoints = {};
  Free(&index.seen_xy);
  model.point_ids.reserve(index.points.size());
  model.points.reserve(3 * index.points.size());
  for (const size_t p : OrderById(index.points)) {
    const ColmapIndex::Point& point = index.points[p];
    model.point_ids.push_back(static_cast<int64_t>(point.id));
    model.points.insert(model.points.end(), point.xyz.begin(), point.xyz.end());
  }
  Free(&index.points);
  return model;
}

ColmapObservations SortColmapObservations(const ColmapIndex& index,
                                          const std::vector<int32_t>& point_of_seen) {
  const std::vector<size_t> images_by_id = OrderById(index.images);
  const std::vector<size_t> points_by_id = OrderById(index.points);
  // By position of the point: its row by id, and the next row of its observations.
  std::vector<int32_t> point_row(points_by_id.size());
  std::vector<size_t> next(points_by_id.size(), 0);
  for (const int32_t point : point_of_seen) ++next[static_cast<size_t>(point)];
  size_t num_rows = 0;
  for (size_t row = 0; row < points_by_id.size(); ++row) {
    point_row[points_by_id[row]] = static_cast<int32_t>(row);
    num_rows += std::exchange(next[points_by_id[row]], num_rows);
  }

  ColmapObservations result;
  result.image.resize(num_rows);
  result.point.resize(num_rows);
  result.keypoint.resize(num_rows);
  result.xy.resize(2 * num_rows);
  for (size_t i = 0; i < images_by_id.size(); ++i) {
    const ColmapIndex::Image& image = index.images[images_by_id[i]];
    size_t seen = index.keypoints.Row(image.first_keypoint);
    for (uint64_t k = 0; k < image.num_keypoints; ++k) {
      if (!index.keypoints.IsMarked(image.first_keypoint + k)) continue;
      const auto point = static_cast<size_t>(point_of_seen[seen]);
      const size_t row = next[point]++;
      result.image[row] = static_cast<int32_t>(i);
      result.point[row] = point_row[point];
      result.keypoint[row] = static_cast<int32_t>(k);
      result.xy[2 * row] = index.seen_xy[2 * seen];
      result.xy[2 * row + 1] = index.seen_xy[2 * seen + 1];
      ++seen;
    }
  }
  return result;
}

const CameraModel* FindColmapCameraModel(int32_t id) {
  return id >= 0 && id < kNumCameraModels ? AllCameraModels() + id : nullptr;
}

void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const CameraModel& model, const double* params) {
  for (int i = 0; i < model.num_params; ++i) {
    const CameraParam::Kind kind = model.params[i].kind;
    const bool is_positive = kind == CameraParam::kFocal || kind == CameraParam::kMetadata;
    if (std::isfinite(params[i]) && (!is_positive || params[i] > 0.0)) continue;
    const std::string expected = kind == CameraParam::kFocal      ? "a focal length above 0"
                                 : kind == CameraParam::kMetadata ? "an image size above 0"
                                                                  : "a finite number";
    file.Fail(position, subject + ": expected " + expected + " as parameter " + std::to_string(i) +
                            " of " + model.name + ", found " + FormatNumber(params[i]));
  }
}

void CheckPose(const ModelFile& file, uint64_t position, const std::string& subject,
               const double* pose) {
  for (int i = 0; i < 7; ++i) {
    if (!std::isfinite(pose[i])) {
      file.Fail(position, subject + ": expected a finite pose, found " + FormatNumber(pose[i]));
    }
  }
  const double squared_norm =
      pose[0] * pose[0] + pose[1] * pose[1] + pose[2] * pose[2] + pose[3] * pose[3];
  if (!(squared_norm > 0.0) || !std::isfinite(squared_norm)) {
    file.Fail(position, subject + ": expected a quaternion of norm 1, found norm " +
                            FormatNumber(std::hypot(std::hypot(pose[0], pose[1]),
                                                    std::hypot(pose[2], pose[3]))));
  }
}

void CheckCameraSize(const ModelFile& file, uint64_t position, const std::string& subject,
                     uint64_t width, uint64_t height) {
  constexpr uint64_t kMaxSize = std::numeric_limits<int64_t>::max();
  if (width <= kMaxSize && height <= kMaxSize) return;
  file.Fail(position, subject + ": expected an image size below 2^63, found " +
                          std::to_string(width) + " x " + std::to_string(height));
}

void CheckImageName(const ModelFile& file, uint64_t position, const std::string& subject,
                    std::string_view name) {
  if (Printable(name) == name) return;
  file.Fail(position, subject + ": expected a name in UTF-8 without control characters, found " +
                          Quoted(name));
}

std::string FormatNumber(double value) {
  char text[32];
  const auto [end, error] = std::to_chars(text, text + sizeof(text), value);
  return error == std::errc() ? std::string(text, end) : "?";
}

namespace {

[[noreturn]] void FailToRead(const std::string& path, const std::string& reason) {
  throw InputError(Printable(path) + ": expected a readable file, found: " + reason);
}

/// Opens a regular file; the descriptor is closed with the last copy of the pointer.
std::shared_ptr<const int> OpenRegularFile(const std::string& path) {
  struct stat status;
  // Checked before open(), which would wait for a writer if this is a named pipe.
  if (stat(path.c_str(), &status) != 0) FailToRead(path, std::strerror(errno));
  if (!S_ISREG(status.st_mode)) FailToRead(path, "not a regular file");
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) FailToRead(path, std::strerror(errno));
  return {new int(descriptor), [](const int* opened) {
            close(*opened);
            delete opened;
          }};
}

struct stat StatusOf(int descriptor, const std::string& path) {
  struct stat status;
  if (fstat(descriptor, &status) != 0) FailToRead(path, std::strerror(errno));
  return status;
}

/// Time of the last change of a file, in nanoseconds.
int64_t ChangedAt(const struct stat& status) {
#ifdef __APPLE__
  const timespec& time = status.st_mtimespec;
#else
  const timespec& time = status.st_mtim;
#endif
  return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

/// Reads up to `size` bytes from `position` on and returns the number of bytes read.
size_t ReadBytes(int descriptor, const std::string& path, uint64_t position, char* buffer,
                 size_t size) {
  size_t done = 0;
  while (done < size) {
    const ssize_t count =
        pread(descriptor, buffer + done, size - done, static_cast<off_t>(position + done));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) FailToRead(path, std::strerror(errno));
    if (count == 0) break;  // shortened while we read
    done += static_cast<size_t>(count);
  }
  return done;
}

}  // namespace

ModelFile::ModelFile(std::string path, Kind kind) {
  *this = Stream(std::move(path), kind, {});
  if (size_ > kLargestInMemory) return;
  contents_ = std::make_unique<char[]>(size_);
  size_ = ReadBytes(*descriptor_, path_, 0, contents_.get(), size_);
  descriptor_ = nullptr;
}

ModelFile ModelFile::Stream(std::string path, Kind kind, std::function<void()> on_block) {
  ModelFile file;
  file.path_ = std::move(path);
  file.kind_ = kind;
  file.descriptor_ = OpenRegularFile(file.path_);
  const struct stat status = StatusOf(*file.descriptor_, file.path_);
  file.size_ = static_cast<size_t>(status.st_size);
  file.changed_at_ = ChangedAt(status);
  file.on_block_ = std::move(on_block);
  return file;
}

void ModelFile::ReadAt(uint64_t position, char* buffer, size_t count) const {
  if (on_block_) on_block_();
  if (!is_stream()) {
    contents().copy(buffer, count, position);
    return;
  }
  const size_t done = ReadBytes(*descriptor_, path_, position, buffer, count);
  if (done != count || has_changed()) FailAsChanged(Printable(path_));
}

bool ModelFile::has_changed() const {
  if (!is_stream()) return false;
  struct stat status;
  if (fstat(*descriptor_, &status) != 0) return true;  // removed from a server
  return static_cast<size_t>(status.st_size) != size_ || ChangedAt(status) != changed_at_;
}

std::string ModelFile::Complaint(uint64_t position, const std::string& message) const {
  const std::string path = Printable(path_);
  const std::string place = std::to_string(position);
  return (kind_ == Kind::kText ? path + ":" + place : path + ": byte " + place) + ": " + message;
}

void ModelFile::Fail(uint64_t position, const std::string& message) const {
  throw InputError(Complaint(position, message));
}

}  // namespace bundle
