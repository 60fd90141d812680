#include "core/covariance/gauge_sums.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/dense/decompositions.h"
#include "core/model/scene_frame.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using PoseRows = Eigen::Matrix<double, kPoseSize, kSimilarities, Eigen::RowMajor>;

}  // namespace

void GaugeTriangle::Add(const SimilarityRow& by_cameras, const SimilarityRow& by_points) {
  rows_.row(count_++) = by_cameras + by_points;
  parts_ += by_cameras.cwiseAbs2() + by_points.cwiseAbs2();
  if (count_ == kRows) Fold();
}

void GaugeTriangle::Add(const GaugeTriangle& other) {
  parts_ += other.parts_;
  for (int i = 0; i < other.count_; ++i) {
    rows_.row(count_++) = other.rows_.row(i);
    if (count_ == kRows) Fold();
  }
}

SimilaritySquare GaugeTriangle::Triangle() {
  Fold();
  return rows_.topRows<kSimilarities>();
}

void GaugeTriangle::Fold() {
  rows_.bottomRows(kRows - count_).setZero();
  rows_.topRows<kSimilarities>() = TriangleOfQr(Eigen::MatrixXd(rows_));
  count_ = kSimilarities;
}

SimilarityMoves::SimilarityMoves(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                 const CameraStates& states)
    : problem_(problem), num_unknowns_(layout.state_size()) {
  const SceneFrame frame(problem);
  std::copy_n(frame.center, 3, center_);
  size_ = frame.size > 0 && std::isfinite(frame.size) ? frame.size : 1;
  cameras_ = GaugeDirections(problem, layout, states, center_);
  for (int unknown = 0; unknown < num_unknowns_; ++unknown) {
    for (int m = 0; m < 3; ++m) cameras_[size_t(unknown) * kSimilarities + m] *= size_;
  }
  // The position of a sensor on its rig scales with the world.
  for (int sensor = 0; sensor < problem.num_sensors; ++sensor) {
    const int pose = PoseOfSensor(problem, sensor);
    if (layout.pose_block(pose) < 0) continue;
    const CameraBlock& block = layout.blocks()[layout.pose_block(pose)];
    for (int k = 0; k < block.size; ++k) {
      const int axis = block.columns[k] - 3;
      if (axis < 0) continue;
      cameras_[size_t(block.offset + k) * kSimilarities + 6] = states.pose(pose).translation[axis];
    }
  }
}

Eigen::Matrix<double, kPoseSize, kSimilarities> SimilarityMoves::OfPose(
    const PoseState& pose) const {
  PoseRows rows;
  GaugeRowsOfPose(pose, center_, rows.data());
  rows.leftCols<3>() *= size_;
  return rows;
}

Eigen::Matrix<double, 3, kSimilarities> SimilarityMoves::OfPoint(int point) const {
  Eigen::Matrix<double, 3, kSimilarities, Eigen::RowMajor> rows;
  GaugeRowsOfPoint(problem_.points + 3 * int64_t{point}, center_, rows.data());
  rows.leftCols<3>() *= size_;
  return rows;
}

GaugeSums::GaugeSums(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const CameraStates& states, int num_threads)
    : layout_(layout), moves_(problem, layout, states), of_thread_(num_threads) {
  total_.eliminated.assign(static_cast<size_t>(moves_.num_unknowns()) * kSimilarities, 0.0);
  for (Sums& sums : of_thread_) sums.eliminated = total_.eliminated;
}

SimilarityRow GaugeSums::ByBlocks(const ObservationRows& rows, int row, int first, int last) const {
  SimilarityRow sum = SimilarityRow::Zero();
  for (int b = first; b < last; ++b) {
    const CameraBlock& block = layout_.blocks()[rows.block[b]];
    const double* const j = rows.jacobian[b] + row * rows.size[b];
    for (int k = 0; k < rows.size[b]; ++k) sum += j[k] * moves_.OfUnknown(block.offset + k);
  }
  return sum;
}

void GaugeSums::AddObservation(const ObservationRows& rows, GaugeTriangle* triangle) const {
  const int first = rows.num_image_blocks, last = rows.num_blocks;
  for (int row = 0; row < 2; ++row) {
    triangle->Add(ByBlocks(rows, row, 0, first), ByBlocks(rows, row, first, last));
  }
}

void GaugeSums::AddPoint(int point, const PointBlocks& blocks, const PointAssembler& rows,
                         int thread) {
  using Rows3 = Eigen::Matrix<double, 3, kSimilarities>;
  Sums& sums = of_thread_[thread];
  const Rows3 n = moves_.OfPoint(point);
  for (int i = 0; i < rows.num_rows(); ++i) {
    const ObservationRows& of = rows.row(i);
    for (int row = 0; row < 2; ++row) {
      const double* const j = of.point + 3 * row;
      sums.triangle.Add(ByBlocks(of, row, 0, of.num_blocks),
                        j[0] * n.row(0) + j[1] * n.row(1) + j[2] * n.row(2));
    }
  }
  if (blocks.num_null > 0) return;  // not included in the constraints
  const Rows3 weighted = Eigen::Map<const Matrix3>(blocks.inverse) * n;
  sums.weighted += n.transpose() * weighted;
  sums.squares += n.transpose() * n;
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const CameraBlock& block = layout_.blocks()[blocks.blocks[b]];
    for (int k = 0; k < block.size; ++k) {
      const double* const y = &blocks.y[3 * size_t(blocks.begin[b] + k)];
      Eigen::Map<SimilarityRow>(&sums.eliminated[size_t(block.offset + k) * kSimilarities]) +=
          y[0] * n.row(0) + y[1] * n.row(1) + y[2] * n.row(2);
    }
  }
}

void GaugeSums::Add(const PointSurvey& survey, int thread) {
  using Squares = Eigen::Map<const Eigen::Matrix<double, kSimilarities, kMoves, Eigen::RowMajor>>;
  Sums& sums = of_thread_[thread];
  sums.triangle.AddZeros(Eigen::Map<const SimilarityRow>(survey.parts));
  sums.weighted += Squares(survey.weighted).leftCols<kSimilarities>();
  sums.squares += Squares(survey.own).leftCols<kSimilarities>();
}

void GaugeSums::AddRow(const double* by_images, const double* by_point, int thread) {
  of_thread_[thread].triangle.Add(Eigen::Map<const SimilarityRow>(by_images),
                                  Eigen::Map<const SimilarityRow>(by_point));
}

void GaugeSums::AddEliminated(int unknown, const double* row, int thread) {
  double* const to = &of_thread_[thread].eliminated[size_t(unknown) * kSimilarities];
  for (int m = 0; m < kSimilarities; ++m) to[m] += row[m];
}

void GaugeSums::Finish() {
  for (const Sums& sums : of_thread_) {
    total_.triangle.Add(sums.triangle);
    total_.weighted += sums.weighted;
    total_.squares += sums.squares;
    for (size_t i = 0; i < sums.eliminated.size(); ++i) {
      total_.eliminated[i] += sums.eliminated[i];
    }
  }
  of_thread_.clear();
}

}  // namespace bundle
