#include "core/io/colmap_model.h"

#include <algorithm>
#include <unordered_map>
#include <utility>

#include "core/error.h"
#include "core/io/colmap_checker.h"
#include "core/io/printable.h"

namespace bundle {
namespace {

/// The rows of the images by their ids.
std::unordered_map<uint64_t, int64_t> RowsOfImages(const ColmapModel& model) {
  std::unordered_map<uint64_t, int64_t> rows;
  for (size_t row = 0; row < model.images_by_id.size(); ++row) {
    rows.emplace(model.index.images[model.images_by_id[row]].id, static_cast<int64_t>(row));
  }
  return rows;
}

void CheckSensors(const ColmapIndex& index, const std::string& folder) {
  for (const size_t r : OrderById(index.rigs)) {
    const ColmapIndex::Rig& rig = index.rigs[r];
    if (rig.sensors.size() < 2) continue;
    const ColmapIndex::Sensor& reference = rig.sensors.front();
    throw InputError(Printable(folder) + ": rig " + std::to_string(rig.id) + " has " +
                     std::to_string(rig.sensors.size()) + " sensors (reference: " +
                     (reference.type == SensorType::kCamera ? "camera " : "imu ") +
                     std::to_string(reference.id) + "): only single-sensor rigs are supported");
  }
}

/// Throws InputError for a frame of several images.
std::vector<int64_t> ImagesOfFrames(const ColmapModel& model, const std::string& folder) {
  const std::unordered_map<uint64_t, int64_t> rows = RowsOfImages(model);
  std::vector<int64_t> image_of_frame(model.index.frames.size(), -1);
  for (const size_t f : OrderById(model.index.frames)) {
    const ColmapIndex::Frame& frame = model.index.frames[f];
    int64_t num_images = 0;
    for (const ColmapIndex::Datum& datum : frame.data) {
      if (datum.sensor.type != SensorType::kCamera) continue;
      image_of_frame[f] = rows.at(datum.id);
      ++num_images;
    }
    if (num_images > 1) {
      throw InputError(Printable(folder) + ": frame " + std::to_string(frame.id) +
                       ": expected at most one image, found " + std::to_string(num_images));
    }
  }
  return image_of_frame;
}

void PutPose(const std::array<double, 7>& pose, double* row) {
  std::copy_n(pose.begin() + 1, 3, row);
  row[3] = pose[0];
  std::copy_n(pose.begin() + 4, 3, row + 4);
}

}  // namespace

std::vector<double> ColmapModel::CamFromWorld() const {
  std::vector<double> poses(7 * index.images.size());
  for (size_t row = 0; row < images_by_id.size(); ++row) {
    PutPose(index.images[images_by_id[row]].pose, poses.data() + 7 * row);
  }
  for (size_t f = 0; f < index.frames.size(); ++f) {
    if (image_of_frame[f] < 0) continue;
    PutPose(index.frames[f].pose, poses.data() + 7 * image_of_frame[f]);
  }
  return poses;
}

ColmapModel ReadColmapModel(const std::string& folder) {
  ColmapModel model;
  model.index = ScanColmapModel(folder, /*keep_contents=*/true);
  const std::vector<int64_t> point_of_keypoint = CheckColmapReferences(model.index);
  CheckSensors(model.index, folder);
  model.cameras_by_id = OrderById(model.index.cameras);
  model.images_by_id = OrderById(model.index.images);
  model.points_by_id = OrderById(model.index.points);
  model.image_of_frame = ImagesOfFrames(model, folder);
  model.observations = SortColmapObservations(model.index, point_of_keypoint);
  // What only the check needed: the files hold it too.
  model.index.keypoint_point_ids = {};
  model.index.triangulated_xy = {};
  model.index.track_elements = {};
  return model;
}

}  // namespace bundle
