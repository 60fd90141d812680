#include "core/io/colmap_rigs.h"

/// Images of a COLMAP model whose poses follow from a rig, and images with a pose of their own.
///
/// COLMAP puts every image into a frame of a rig. Most rigs are one camera and their frames one
/// image: such an image has the pose rig_from_world, and the problem has no rig and no frame for
/// it, even if the rig has an IMU. All other rigs with an image become rows of the problem's
/// arrays.

#include <algorithm>
#include <map>
#include <string>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "core/io/colmap_index.h"
#include "core/io/colmap_model.h"

namespace bundle {
namespace {

/// True if the only camera of a rig is its reference sensor.
bool IsTrivial(const ColmapIndex::Rig& rig) {
  return std::none_of(
      rig.sensors.begin() + (rig.sensors.empty() ? 0 : 1), rig.sensors.end(),
      [](const ColmapIndex::Sensor& sensor) { return sensor.type == SensorType::kCamera; });
}

struct FramedImage {
  int64_t row;    ///< row of the image in our arrays
  size_t sensor;  ///< in the sensors of its rig
};

class RigFinder {
 public:
  explicit RigFinder(ColmapModel* model) : model_(*model), index_(model->index) {
    for (size_t row = 0; row < model_.images_by_id.size(); ++row) {
      rows_.emplace(index_.images[model_.images_by_id[row]].id, static_cast<int64_t>(row));
    }
    for (size_t r = 0; r < index_.rigs.size(); ++r) rigs_.emplace(index_.rigs[r].id, r);
  }

  void Run() {
    model_.image_of_frame.assign(index_.frames.size(), -1);
    for (const size_t f : OrderById(index_.frames)) {
      const ColmapIndex::Frame& frame = index_.frames[f];
      const size_t r = rigs_.at(frame.rig_id);
      const std::vector<FramedImage> images = ImagesOf(frame, index_.rigs[r]);
      if (images.empty()) continue;
      if (IsTrivial(index_.rigs[r])) {
        model_.image_of_frame[f] = images.front().row;
      } else {
        framed_.push_back({f, r, images});
      }
    }
    if (!framed_.empty()) FillRows();
  }

 private:
  struct Framed {
    size_t frame;
    size_t rig;
    std::vector<FramedImage> images;
  };

  std::vector<FramedImage> ImagesOf(const ColmapIndex::Frame& frame, const ColmapIndex::Rig& rig) {
    std::vector<FramedImage> images;
    for (const ColmapIndex::Datum& datum : frame.data) {
      if (datum.sensor.type != SensorType::kCamera) continue;
      const auto sensor = std::find(rig.sensors.begin(), rig.sensors.end(), datum.sensor);
      images.push_back(
          {rows_.at(datum.id), static_cast<size_t>(std::distance(rig.sensors.begin(), sensor))});
      const auto same = [&](const FramedImage& image) {
        return image.sensor == images.back().sensor;
      };
      const int64_t count = std::count_if(images.begin(), images.end(), same);
      if (count > 1) {
        index_.frames_file.Fail(frame.at, RecordName("frame", frame.id) +
                                              ": expected at most one image of " +
                                              RecordName("camera", datum.sensor.id) + ", found " +
                                              std::to_string(count));
      }
    }
    return images;
  }

  void FillRows() {
    ColmapRigs& rigs = model_.rigs;
    std::vector<bool> is_used(index_.rigs.size(), false);
    for (const Framed& framed : framed_) is_used[framed.rig] = true;
    std::map<std::pair<size_t, size_t>, int32_t> rows;
    for (const size_t r : OrderById(index_.rigs)) {
      if (is_used[r]) AddSensors(r, &rows);
    }
    rigs.image_frame.assign(model_.images_by_id.size(), -1);
    rigs.image_sensor.assign(model_.images_by_id.size(), -1);
    for (const Framed& framed : framed_) {
      for (const FramedImage& image : framed.images) {
        const auto row = static_cast<size_t>(image.row);
        rigs.image_frame[row] = static_cast<int32_t>(rigs.frames.size());
        if (image.sensor == 0) continue;
        const auto found = rows.find({framed.rig, image.sensor});
        if (found == rows.end()) FailWithoutPose(framed, image);
        rigs.image_sensor[row] = found->second;
      }
      rigs.frames.push_back(framed.frame);
    }
  }

  /// The cameras of a rig with a pose, by id.
  void AddSensors(size_t r, std::map<std::pair<size_t, size_t>, int32_t>* rows) {
    const ColmapIndex::Rig& rig = index_.rigs[r];
    std::vector<size_t> sensors;
    for (size_t s = 1; s < rig.sensors.size(); ++s) {
      if (rig.sensors[s].type == SensorType::kCamera && rig.poses[s].is_known) sensors.push_back(s);
    }
    std::sort(sensors.begin(), sensors.end(),
              [&](size_t a, size_t b) { return rig.sensors[a].id < rig.sensors[b].id; });
    for (const size_t s : sensors) {
      rows->emplace(std::make_pair(r, s), static_cast<int32_t>(model_.rigs.sensors.size()));
      model_.rigs.sensors.push_back({r, s});
    }
  }

  [[noreturn]] void FailWithoutPose(const Framed& framed, const FramedImage& image) const {
    const ColmapIndex::Rig& rig = index_.rigs[framed.rig];
    const ColmapIndex::Image& taken =
        index_.images[model_.images_by_id[static_cast<size_t>(image.row)]];
    index_.rigs_file.Fail(rig.at, RecordName("rig", rig.id) + ": expected the pose of " +
                                      RecordName("camera", rig.sensors[image.sensor].id) +
                                      " on the rig, as it took " + RecordName("image", taken.id) +
                                      " of " + RecordName("frame", index_.frames[framed.frame].id));
  }

  ColmapModel& model_;
  const ColmapIndex& index_;
  std::unordered_map<uint64_t, int64_t> rows_;
  std::unordered_map<uint32_t, size_t> rigs_;
  std::vector<Framed> framed_;
};

}  // namespace

void FindColmapRigs(ColmapModel* model) { RigFinder(model).Run(); }

}  // namespace bundle
