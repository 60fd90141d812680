#include "core/fused/eliminate/model_groups.h"

#include <algorithm>

#include "core/cameras/registry.h"

namespace bundle::fused {
namespace {

uint32_t ColumnBits(const ParameterLayout& layout, int block) {
  uint32_t bits = 0;
  if (block < 0) return bits;
  const CameraSideBlock& columns = layout.blocks()[block];
  for (int k = 0; k < columns.size; ++k) bits |= 1u << columns.columns[k];
  return bits;
}

}  // namespace

bool ModelGroups::mixed() const {
  for (const ModelGroup& group : groups) {
    if (4 * group.num_quads != num_columns()) return true;
  }
  return false;
}

int ModelGroups::block_size() const {
  if (!mixed()) return num_rows * num_columns();
  int64_t rows = 0, columns = 0;
  for (size_t i = 0; i < image_group.size(); ++i) {
    rows += image_columns[i];
    columns += 4 * image_quads[i];
  }
  const auto images = static_cast<int64_t>(image_group.size());
  return static_cast<int>(std::max<int64_t>(1, rows * columns / (images * images)));
}

ModelGroups GroupImages(const ProblemView& problem, const ParameterLayout& layout) {
  ModelGroups result;
  std::vector<int> group_of_model(kNumCameraModels, -1);
  std::vector<uint32_t> bits;
  for (int i = 0; i < problem.num_images; ++i) {
    const int camera = problem.image_camera[i];
    const CameraModel* const model = problem.camera_models[camera];
    const uint32_t columns =
        ColumnBits(layout, layout.image_block(i)) | ColumnBits(layout, layout.camera_block(camera));
    result.image_refined.push_back(columns != 0 ? 1 : 0);
    if (model == nullptr) {
      result.image_group.push_back(0);
      continue;
    }
    int& group = group_of_model[model - AllCameraModels()];
    if (group < 0) {
      group = static_cast<int>(result.groups.size());
      ModelGroup fresh;
      fresh.model = static_cast<int>(model - AllCameraModels());
      fresh.num_params = model->num_params;
      result.groups.push_back(fresh);
      bits.push_back(0);
    }
    bits[group] |= columns;
    result.image_group.push_back(static_cast<uint8_t>(group));
  }
  for (size_t g = 0; g < bits.size(); ++g) {
    ModelGroup& group = result.groups[g];
    for (int8_t j = 0; j < kPoseSize + kMaxCameraParams; ++j) {
      if (bits[g] >> j & 1u) group.columns[group.num_columns++] = j;
    }
    group.num_quads = std::max(1, (group.num_columns + 3) / 4);
    result.num_rows = std::max(result.num_rows, group.num_columns);
  }
  for (const uint8_t g : result.image_group) {
    result.image_columns.push_back(static_cast<uint8_t>(result.groups[g].num_columns));
    result.image_quads.push_back(static_cast<uint8_t>(result.groups[g].num_quads));
  }
  return result;
}

}  // namespace bundle::fused
