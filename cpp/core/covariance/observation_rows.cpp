#include "core/covariance/observation_rows.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/factors/loss.h"
#include "core/factors/reprojection.h"
#include "core/factors/rig_pose.h"

namespace bundle {
namespace {

constexpr int kMaxLocal = kImageColumns;

/// A block whose unknowns equal local columns.
LocalMap PlainMap(int index, const CameraBlock& block) {
  LocalMap map{index, block.size, {}, {}};
  map.columns.assign(block.columns, block.columns + block.size);
  return map;
}

LocalMap MapOfLayout(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const CameraStates& states, int image, int place) {
  ColumnMap of_layout;
  layout.FillMap(problem, image, place, states.pose(image), states.twist_map(image), &of_layout);
  const int index = layout.blocks_of(image)[place];
  LocalMap map{index, layout.blocks()[index].size, {}, {}};
  map.columns.assign(of_layout.columns, of_layout.columns + of_layout.num_columns);
  map.values.assign(of_layout.values, of_layout.values + of_layout.num_columns * map.size);
  return map;
}

/// A block of the pose of a frame or a sensor; `whole` maps it to the pose of the image.
LocalMap MapOfRig(int index, const CameraBlock& block, const double whole[kPoseSize * kPoseSize]) {
  LocalMap map{index, block.size, {}, {}};
  for (int i = 0; i < kPoseSize; ++i) {
    map.columns.push_back(static_cast<int8_t>(i));
    for (int k = 0; k < block.size; ++k) {
      map.values.push_back(whole[kPoseSize * i + block.columns[k]]);
    }
  }
  return map;
}

void HoldUnknowns(const std::vector<uint8_t>& held, int offset, LocalMap* map) {
  const auto first = held.begin() + offset;
  if (std::none_of(first, first + map->size, [](uint8_t bit) { return bit != 0; })) return;
  if (map->values.empty()) {  // the identity
    map->values.assign(static_cast<size_t>(map->size) * map->size, 0.0);
    for (int k = 0; k < map->size; ++k) map->values[k * map->size + k] = 1;
  }
  for (size_t i = 0; i < map->values.size(); ++i) {
    if (first[i % map->size] != 0) map->values[i] = 0;
  }
}

/// Rows by (w, t), followed by those by the model's parameters, and from kFirstTwist on by the
/// twist.
bool EvaluateLocal(const CameraModel& model, const PoseState& pose, const ImageShutter* shutter,
                   const double* params, const double* point, const double* xy,
                   Cheirality cheirality, double* residual, double* local, double* by_point) {
  ReprojectionJacobian jacobian;
  if (!EvaluateReprojection(model, pose, params, point, xy, cheirality, residual, &jacobian,
                            shutter)) {
    return false;
  }
  std::copy_n(jacobian.point, 6, by_point);
  for (int row = 0; row < 2; ++row) {
    double* const to = local + kMaxLocal * row;
    std::copy_n(jacobian.pose + kPoseSize * row, kPoseSize, to);
    std::copy_n(jacobian.params + model.num_params * row, model.num_params, to + kPoseSize);
    if (shutter == nullptr) continue;
    std::copy_n(jacobian.twist + kTwistSize * row, kTwistSize, to + kFirstTwist);
  }
  return true;
}

void Chain(const double* local, const LocalMap& map, double weight, double* out) {
  const int num_columns = static_cast<int>(map.columns.size());
  for (int row = 0; row < 2; ++row, local += kMaxLocal, out += map.size) {
    if (map.values.empty()) {
      for (int k = 0; k < map.size; ++k) out[k] = weight * local[map.columns[k]];
      continue;
    }
    std::fill_n(out, map.size, 0.0);
    for (int i = 0; i < num_columns; ++i) {
      const double factor = weight * local[map.columns[i]];
      const double* const values = map.values.data() + i * map.size;
      for (int k = 0; k < map.size; ++k) out[k] += factor * values[k];
    }
  }
}

}  // namespace

std::vector<LocalMap> FindLocalMaps(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& states, int image,
                                    const std::vector<uint8_t>& held) {
  std::vector<LocalMap> maps;
  const RigPose rig = states.rig(image);
  const ParameterLayout::ImageBlocks& of = layout.blocks_of(image);
  for (int place = 0; place < static_cast<int>(of.size()); ++place) {
    if (of[place] < 0) continue;
    const CameraBlock& block = layout.blocks()[of[place]];
    const bool is_sensor = place == ParameterLayout::kSensorBlock;
    if (rig.frame != nullptr && (is_sensor || place == ParameterLayout::kPoseBlock)) {
      double whole[kPoseSize * kPoseSize];
      is_sensor ? SensorMap(rig, whole) : FrameMap(rig, whole);
      maps.push_back(MapOfRig(of[place], block, whole));
    } else if (layout.HasMap(problem, image, place)) {
      maps.push_back(MapOfLayout(problem, layout, states, image, place));
    } else {
      maps.push_back(PlainMap(of[place], block));
    }
    if (!held.empty()) HoldUnknowns(held, block.offset, &maps.back());
  }
  return maps;
}

ObservationEvaluator::ObservationEvaluator(const AdjustmentProblem& problem,
                                           const ParameterLayout& layout,
                                           const SolveOptions& options)
    : problem_(problem),
      layout_(layout),
      states_(problem, layout),
      points_(problem.points),
      maps_(problem.num_images),
      loss_(options.loss),
      loss_scale_(options.loss_scale),
      cheirality_(options.cheirality) {
  Hold({});
}

void ObservationEvaluator::Hold(const std::vector<uint8_t>& held) {
  for (int i = 0; i < problem_.num_images; ++i) {
    maps_[i] = FindLocalMaps(problem_, layout_, states_, i, held);
  }
}

void ObservationEvaluator::SetScores(std::vector<double> scores, double kappa) {
  root_curvature_ = std::sqrt(kappa);
  for (double& score : scores) score /= root_curvature_;
  scores_ = std::move(scores);
}

void ObservationEvaluator::MoveTo(const double* state, const double* points,
                                  const std::vector<uint8_t>& held) {
  states_.Update(state);
  points_ = points;
  Hold(held);
}

void ObservationEvaluator::LossOf(const double residual[2], double rho[3]) const {
  ValueOfLoss(loss_, loss_scale_, SquaredNorm(residual, 2), rho);
}

void ObservationEvaluator::AddTransposed(int64_t observation, const double v[2], double* unknowns,
                                         double* params, double* point) const {
  const int image = problem_.observation_image[observation];
  const int camera = problem_.image_camera[image];
  const CameraModel& model = *problem_.camera_models[camera];
  const ImageShutter* const shutter = states_.shutter(image);
  double residual[2];
  ReprojectionJacobian j;
  if (!EvaluateReprojection(model, states_.pose(image), states_.params(camera),
                            points_ + 3 * int64_t{problem_.observation_point[observation]},
                            problem_.observation_xy + 2 * observation, cheirality_, residual, &j,
                            shutter)) {
    return;
  }
  double local[kMaxLocal];
  const auto pull = [v](const double* rows, int size, double* to) {
    for (int k = 0; k < size; ++k) to[k] = v[0] * rows[k] + v[1] * rows[size + k];
  };
  double by_point[3];
  pull(j.pose, kPoseSize, local);
  pull(j.params, model.num_params, local + kPoseSize);
  if (shutter != nullptr) pull(j.twist, kTwistSize, local + kFirstTwist);
  pull(j.point, 3, by_point);
  for (int k = 0; k < 3; ++k) point[k] += by_point[k];
  for (int k = 0; k < model.num_params; ++k) params[k] += local[kPoseSize + k];
  for (const LocalMap& map : maps_[image]) {
    double* const to = unknowns + layout_.blocks()[map.block].offset;
    const double* values = map.values.data();
    for (size_t i = 0; i < map.columns.size(); ++i) {
      const double of = local[map.columns[i]];
      if (map.values.empty()) {
        to[i] += of;
        continue;
      }
      for (int k = 0; k < map.size; ++k) to[k] += of * *values++;
    }
  }
}

bool ObservationEvaluator::Evaluate(int64_t observation, ObservationRows* rows,
                                    double* by_params) const {
  const int image = problem_.observation_image[observation];
  const int camera = problem_.image_camera[image];
  double local[2 * kMaxLocal];
  if (!EvaluateLocal(*problem_.camera_models[camera], states_.pose(image), states_.shutter(image),
                     states_.params(camera),
                     points_ + 3 * int64_t{problem_.observation_point[observation]},
                     problem_.observation_xy + 2 * observation, cheirality_, rows->residual, local,
                     rows->point)) {
    return false;
  }
  const double sigma =
      problem_.observation_sigma == nullptr ? 1 : problem_.observation_sigma[observation];
  double rho[3];
  ValueOfLoss(loss_, loss_scale_, SquaredNorm(rows->residual, 2) / (sigma * sigma), rho);
  double weight = std::sqrt(rho[1]) / sigma;
  for (double& value : rows->residual) value *= weight;
  weight *= root_curvature_;
  rows->observation = observation;
  rows->weight = root_curvature_ * root_curvature_ * rho[1];
  std::copy_n(scores_.empty() ? rows->residual : &scores_[2 * static_cast<size_t>(observation)], 2,
              rows->score);
  for (double& value : rows->point) value *= weight;
  rows->bend = rho[2] == 0 || rho[1] == 0 ? 0 : 2 * rho[2] / (rho[1] * rho[1]);
  const int num_params = problem_.camera_models[camera]->num_params;
  for (int row = 0; by_params != nullptr && row < 2; ++row, by_params += num_params) {
    const double* const from = local + kMaxLocal * row + kPoseSize;
    for (int k = 0; k < num_params; ++k) by_params[k] = weight * from[k];
  }
  rows->num_blocks = 0;
  for (const LocalMap& map : maps_[image]) {
    const int b = rows->num_blocks++;
    rows->block[b] = map.block;
    rows->size[b] = map.size;
    Chain(local, map, weight, rows->jacobian[b]);
  }
  rows->num_image_blocks = rows->num_blocks;
  if (const int kept = layout_.kept_block(problem_.observation_point[observation]); kept >= 0) {
    const int b = rows->num_blocks++;
    rows->block[b] = kept;
    rows->size[b] = 3;
    std::copy_n(rows->point, 6, rows->jacobian[b]);
  }
  return true;
}

}  // namespace bundle
