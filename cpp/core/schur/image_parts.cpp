#include "core/schur/image_parts.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <tuple>

#include "core/cameras/registry.h"

namespace bundle {
namespace {

constexpr int kNumColumns = kImageColumns;
constexpr uint32_t kPoseBits = (1u << kPoseSize) - 1;
/// Columns of a pose, and of the twist that belongs to it.
constexpr uint32_t kMotionBits = kPoseBits | ((1u << kTwistSize) - 1) << kFirstTwist;
constexpr int8_t kPoseColumns[] = {0, 1, 2, 3, 4, 5};
static_assert(sizeof kPoseColumns == kPoseSize);

/// True if the parameters of an image's camera are a part, because other images or frames use them.
bool HasCameraPart(const AdjustmentProblem& problem, const ParameterLayout& layout, int image) {
  const ParameterLayout::ImageBlocks& blocks = layout.blocks_of(image);
  return blocks[ParameterLayout::kCameraBlock] >= 0 ||
         (blocks[ParameterLayout::kTiedBlock] >= 0 && problem.FrameOf(image) >= 0);
}

/// Appends a part with the columns of `bits` to a record.
void AppendPart(uint32_t bits, PartKind kind, ModelGroup* group) {
  ModelGroup::Part& part = group->parts[kind];
  part.first_quad = group->num_quads;
  for (int8_t j = 0; j < kNumColumns; ++j) {
    if (bits >> j & 1u) group->columns[4 * part.first_quad + part.num_columns++] = j;
  }
  part.num_quads = (part.num_columns + 3) / 4;
  group->num_quads += part.num_quads;
}

}  // namespace

ImageParts::ImageParts(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  GroupImages(problem, layout);
  NumberParts(problem, layout);
  Measure();
}

void ImageParts::GroupImages(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  // Model; if the camera is a part, if the sensor is one; if the own part, without a camera, is
  // that of a frame; and if the shutter rolls. Such a part has a pose only, as for the other images
  // of the frame. An image alone of the same model may have its camera in it.
  using Key = std::tuple<int, bool, bool, bool, bool>;
  std::map<Key, int> group_of;
  std::vector<uint32_t> own_bits, camera_bits;
  std::vector<uint32_t> bits_of_model(kNumCameraModels);  // of cameras that are parts
  std::vector<Key> keys;
  for (int i = 0; i < problem.num_images; ++i) {
    const ParameterLayout::ImageBlocks& blocks = layout.blocks_of(i);
    const CameraModel* const model = problem.camera_models[problem.image_camera[i]];
    uint32_t columns = layout.RefinedColumns(problem, i);
    const bool has_sensor = blocks[ParameterLayout::kSensorBlock] >= 0;
    const bool has_camera = HasCameraPart(problem, layout, i);
    image_refined_.push_back(columns != 0 || has_sensor ? 1 : 0);
    // The images of a frame may have different models but have one part.
    if (problem.FrameOf(i) >= 0 && (columns & kPoseBits) != 0) columns |= kPoseBits;
    if (model == nullptr) {
      image_group_.push_back(0);
      continue;
    }
    const auto model_index = static_cast<int>(model - AllCameraModels());
    const bool is_frame_alone = !has_camera && problem.FrameOf(i) >= 0;
    const bool rolls = problem.HasRollingShutter(i);
    const Key key = {model_index, has_camera, has_sensor, is_frame_alone, rolls};
    const auto [at, is_new] = group_of.try_emplace(key, static_cast<int>(groups_.size()));
    if (is_new) {
      ModelGroup fresh;
      fresh.model = model_index;
      fresh.rolls = rolls;
      fresh.num_params = model->num_params;
      groups_.push_back(fresh);
      keys.push_back(key);
      own_bits.push_back(0);
    }
    own_bits[at->second] |= has_camera ? columns & kMotionBits : columns;
    if (has_camera) bits_of_model[model_index] |= columns & ~kMotionBits;
    image_group_.push_back(static_cast<uint8_t>(at->second));
  }
  for (size_t g = 0; g < groups_.size(); ++g) {
    const auto [model, has_camera, has_sensor, is_frame_alone, rolls] = keys[g];
    ModelGroup& group = groups_[g];
    std::fill(std::begin(group.columns), std::end(group.columns), ModelGroup::kNoColumn);
    AppendPart(own_bits[g], kOwnPart, &group);
    if (has_camera) AppendPart(bits_of_model[model], kCameraPart, &group);
    if (has_sensor) {
      AppendPart(kPoseBits, kSensorPart, &group);
      int8_t* const columns = group.columns + 4 * group.parts[kSensorPart].first_quad;
      for (int k = 0; k < kPoseSize; ++k) columns[k] += ModelGroup::kFirstOfSensor;
    }
  }
}

void ImageParts::NumberParts(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  of_image_.assign(size_t{kMaxParts} * problem.num_images, -1);
  std::vector<int> order(problem.num_images);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return layout.blocks_of(a)[ParameterLayout::kPoseBlock] <
           layout.blocks_of(b)[ParameterLayout::kPoseBlock];
  });
  const auto number = [&](int image, PartKind kind, std::vector<int>* numbers, int owner) {
    const ModelGroup& group = groups_[image_group_[image]];
    const ModelGroup::Part& shape = group.parts[kind];
    if (shape.num_columns == 0) return;
    int& part = (*numbers)[owner];
    if (part < 0) {
      part = num_parts();
      parts_.push_back({kind, image, shape.num_columns, shape.num_quads,
                        kind == kSensorPart ? kPoseColumns : group.columns + 4 * shape.first_quad});
      num_kinds_ = std::max(num_kinds_, kind + 1);
    }
    of_image_[size_t{kMaxParts} * image + kind] = part;
  };
  const auto has_model = [&](int image) {
    return problem.camera_models[problem.image_camera[image]] != nullptr;
  };
  std::vector<int> own(NumPoses(problem), -1), cameras(problem.num_cameras, -1),
      sensors(problem.num_sensors, -1);
  for (const int i : order) {
    const ParameterLayout::ImageBlocks& blocks = layout.blocks_of(i);
    const bool is_own =
        blocks[ParameterLayout::kPoseBlock] >= 0 || blocks[ParameterLayout::kBeforeBlock] >= 0 ||
        blocks[ParameterLayout::kAfterBlock] >= 0 || blocks[ParameterLayout::kReadoutBlock] >= 0 ||
        (!HasCameraPart(problem, layout, i) && blocks[ParameterLayout::kTiedBlock] >= 0);
    if (has_model(i) && is_own) number(i, kOwnPart, &own, MovingPose(problem, i));
  }
  num_own_parts_ = num_parts();
  for (int i = 0; i < problem.num_images; ++i) {
    if (!has_model(i) || !HasCameraPart(problem, layout, i)) continue;
    number(i, kCameraPart, &cameras, problem.image_camera[i]);
  }
  for (int i = 0; i < problem.num_images; ++i) {
    if (!has_model(i) || layout.blocks_of(i)[ParameterLayout::kSensorBlock] < 0) continue;
    number(i, kSensorPart, &sensors, problem.SensorOf(i));
  }
}

void ImageParts::Measure() {
  bool is_one_shape = !groups_.empty();
  for (ModelGroup& group : groups_) {
    group.num_quads = std::max(1, group.num_quads);
    record_columns_ = std::max(record_columns_, 4 * group.num_quads);
    is_one_shape &= group.parts[kSensorPart].num_columns == 0;
    for (const PartKind kind : {kOwnPart, kCameraPart}) {
      is_one_shape &= group.parts[kind].num_columns == groups_[0].parts[kind].num_columns;
    }
  }
  if (is_one_shape) {
    own_quads_ = groups_[0].parts[kOwnPart].num_quads;
    camera_quads_ = own_quads_ > 0 ? groups_[0].parts[kCameraPart].num_quads : 0;
  }
  int64_t rows = 0, columns = 0;
  for (const CameraPart& part : parts_) {
    part_rows_.push_back(static_cast<uint8_t>(part.num_columns));
    part_quads_.push_back(static_cast<uint8_t>(part.num_quads));
    part_columns_ = std::max(part_columns_, 4 * part.num_quads);
    rows += part.num_columns;
    columns += 4 * part.num_quads;
  }
  const int64_t count = std::max(1, num_parts());
  block_size_ = static_cast<int>(std::max<int64_t>(1, rows * columns / (count * count)));
}

}  // namespace bundle
