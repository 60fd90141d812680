#include "core/covariance/free_gauge.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"
#include "core/model/gauge.h"
#include "core/model/scene_frame.h"

namespace bundle {
namespace {

constexpr int kCount = kNumGaugeDirections;
using Square = Eigen::Matrix<double, kCount, kCount>;
using Row = Eigen::Matrix<double, 1, kCount>;

/// Of a singular value of J N beside the parts of its rows: rounding is 1e-16 times what scenes far
/// from their centre add; a prior with a sigma of a hundred times the scene is 1e-8 or so.
constexpr double kNull = 1e-11;

struct World {
  double center[3];
  double size;
};

World FindWorld(const ProblemView& problem) {
  const SceneFrame frame(problem);
  World world;
  std::copy_n(frame.center, 3, world.center);
  world.size = frame.size > 0 && std::isfinite(frame.size) ? frame.size : 1;
  return world;
}

void PointRows(const double* point, const World& world, double rows[3][kCount]) {
  const double arm[3] = {point[0] - world.center[0], point[1] - world.center[1],
                         point[2] - world.center[2]};
  for (int k = 0; k < 3; ++k) {
    double axis[3] = {0, 0, 0}, turned[3];
    axis[k] = 1;
    Cross3(axis, arm, turned);
    for (int i = 0; i < 3; ++i) {
      rows[i][k] = i == k ? world.size : 0;
      rows[i][3 + k] = turned[i];
      rows[i][6] = arm[i];
    }
  }
}

/// N with all seven columns.
FullVectors AllDirections(const ReducedSystem& system) {
  const ProblemView& problem = system.problem();
  const ParameterLayout& layout = system.layout();
  const World world = FindWorld(problem);
  const auto num_unknowns = static_cast<size_t>(system.num_unknowns());
  const size_t num_coordinates = 3 * static_cast<size_t>(problem.num_points);
  FullVectors n;
  n.num_columns = kCount;
  n.cameras.assign(num_unknowns * kCount, 0.0);
  n.points.assign(num_coordinates * kCount, 0.0);
  for (int pose = 0; pose < NumPoses(problem); ++pose) {
    if (layout.pose_block(pose) < 0) continue;
    const CameraBlock& block = layout.blocks()[layout.pose_block(pose)];
    const PoseState& state = system.states().pose(pose);
    double rows[kPoseSize * kCount] = {};
    if (pose < problem.num_images + problem.num_frames) {
      GaugeRowsOfPose(state, world.center, rows);
      for (int i = 0; i < kPoseSize; ++i) {
        for (int m = 0; m < 3; ++m) rows[i * kCount + m] *= world.size;
      }
    } else {  // a sensor's place on its rig scales with the world
      for (int i = 0; i < 3; ++i) rows[(3 + i) * kCount + 6] = state.translation[i];
    }
    for (int k = 0; k < block.size && block.columns[k] < kPoseSize; ++k) {
      for (int m = 0; m < kCount; ++m) {
        n.cameras[m * num_unknowns + block.offset + k] = rows[block.columns[k] * kCount + m];
      }
    }
  }
  for (int p = 0; p < problem.num_points; ++p) {
    if (!layout.point_is_free(p)) continue;
    double rows[3][kCount];
    PointRows(problem.points + 3 * int64_t{p}, world, rows);
    for (int i = 0; i < 3; ++i) {
      for (int m = 0; m < kCount; ++m) {
        n.points[m * num_coordinates + 3 * size_t(p) + i] = rows[i][m];
      }
    }
  }
  return n;
}

/// J N as the triangle of its QR factorisation, and the squares of its rows' parts. J^T J of N
/// alone would lose half of the digits.
class GaugeTriangle {
 public:
  void Add(const Row& by_cameras, const Row& by_points) {
    rows_.row(count_++) = by_cameras + by_points;
    parts_ += by_cameras.cwiseAbs2() + by_points.cwiseAbs2();
    if (count_ == kRows) Fold();
  }

  void Add(const GaugeTriangle& other) {
    parts_ += other.parts_;
    for (int i = 0; i < other.count_; ++i) {
      rows_.row(count_++) = other.rows_.row(i);
      if (count_ == kRows) Fold();
    }
  }

  Square Triangle() {
    Fold();
    return rows_.topRows<kCount>();
  }
  const Row& parts() const { return parts_; }

 private:
  static constexpr int kRows = 64;

  void Fold() {
    rows_.bottomRows(kRows - count_).setZero();
    rows_.topRows<kCount>() = TriangleOfQr(rows_);
    count_ = kCount;
  }

  Eigen::Matrix<double, kRows, kCount> rows_ = Eigen::Matrix<double, kRows, kCount>::Zero();
  Row parts_ = Row::Zero();
  int count_ = 0;
};

Row TimesUnknowns(const FullVectors& n, size_t num_unknowns, const double* row, int first,
                  int size) {
  Row sum = Row::Zero();
  for (int m = 0; m < kCount; ++m) {
    const double* const column = &n.cameras[m * num_unknowns + first];
    for (int k = 0; k < size; ++k) sum[m] += row[k] * column[k];
  }
  return sum;
}

Row TimesPoint(const FullVectors& n, size_t num_coordinates, const double* row, int point) {
  Row sum = Row::Zero();
  for (int m = 0; m < kCount; ++m) {
    const double* const column = &n.points[m * num_coordinates + 3 * size_t(point)];
    sum[m] = row[0] * column[0] + row[1] * column[1] + row[2] * column[2];
  }
  return sum;
}

void AddRows(const ReducedSystem& system, const FullVectors& n, const ObservationRows& rows,
             int point, GaugeTriangle* gauge) {
  const auto num_unknowns = static_cast<size_t>(system.num_unknowns());
  for (int row = 0; row < 2; ++row) {
    Row by_cameras = Row::Zero(), by_point = Row::Zero();
    for (int b = 0; b < rows.num_blocks; ++b) {
      by_cameras += TimesUnknowns(n, num_unknowns, rows.jacobian[b] + row * rows.size[b],
                                  system.layout().blocks()[rows.block[b]].offset, rows.size[b]);
    }
    if (point >= 0) {
      by_point =
          TimesPoint(n, 3 * size_t(system.problem().num_points), rows.point + 3 * row, point);
    }
    gauge->Add(by_cameras, by_point);
  }
}

GaugeTriangle SumUp(const ReducedSystem& system, const FullVectors& n) {
  std::vector<GaugeTriangle> of_thread(system.num_threads());
  system.ForPoints([&](int point, const PointBlocks&, const PointAssembler& assembler, int thread) {
    for (int r = 0; r < assembler.num_rows(); ++r) {
      AddRows(system, n, assembler.row(r), point, &of_thread[thread]);
    }
  });
  GaugeTriangle total;
  for (const GaugeTriangle& rows : of_thread) total.Add(rows);
  system.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { AddRows(system, n, rows, -1, &total); });
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const size_t columns = 3 * rows.points.size() + rows.unknowns.size();
    for (int row = 0; row < rows.num_rows; ++row) {
      const double* at = rows.jacobian.data() + row * columns;
      Row by_cameras = Row::Zero(), by_points = Row::Zero();
      for (const int point : rows.points) {
        by_points += TimesPoint(n, 3 * size_t(system.problem().num_points), at, point);
        at += 3;
      }
      for (const int unknown : rows.unknowns) {
        by_cameras += TimesUnknowns(n, size_t(system.num_unknowns()), at++, unknown, 1);
      }
      total.Add(by_cameras, by_points);
    }
  });
  return total;
}

/// The combinations of the seven that nothing sees, 7 x degrees.
Eigen::MatrixXd FindFree(GaugeTriangle rows) {
  const Square triangle = rows.Triangle();
  // A similarity that moves nothing that is seen is none: a scale without points, for instance.
  std::vector<int> kept;
  for (int m = 0; m < kCount; ++m) {
    if (rows.parts()[m] > 0) kept.push_back(m);
  }
  const auto count = static_cast<int>(kept.size());
  if (count == 0) return Eigen::MatrixXd(kCount, 0);
  Eigen::VectorXd scale(count);
  Eigen::MatrixXd scaled(kCount, count);
  for (int i = 0; i < count; ++i) {
    scale[i] = 1 / std::sqrt(rows.parts()[kept[i]]);
    scaled.col(i) = scale[i] * triangle.col(kept[i]);
  }
  const RightSingularVectors singular = DecomposeSingular(scaled);
  int degrees = 0;
  while (degrees < count && singular.values[count - 1 - degrees] < kNull) ++degrees;
  Eigen::MatrixXd free = Eigen::MatrixXd::Zero(kCount, degrees);
  for (int i = 0; i < count; ++i) {
    free.row(kept[i]) = scale[i] * singular.vectors.row(i).tail(degrees);
  }
  return free;
}

using Columns = Eigen::Map<Eigen::MatrixXd>;
using ConstMap = Eigen::Map<const Eigen::MatrixXd>;

/// `degrees` unknowns by which the directions differ most, in their own sigmas.
std::vector<int> ChooseHeld(const FullVectors& n, const std::vector<double>& diagonal) {
  const auto size = static_cast<Eigen::Index>(diagonal.size());
  Eigen::MatrixXd rows = Eigen::Map<const Eigen::MatrixXd>(n.cameras.data(), size, n.num_columns);
  for (Eigen::Index j = 0; j < size; ++j) rows.row(j) *= std::sqrt(std::max(diagonal[j], 0.0));
  std::vector<int> held;
  for (int d = 0; d < n.num_columns; ++d) {
    Eigen::Index longest = 0;
    if (!(rows.rowwise().squaredNorm().maxCoeff(&longest) > 0)) break;
    held.push_back(static_cast<int>(longest));
    const Eigen::VectorXd direction = rows.row(longest).normalized();
    rows -= (rows * direction) * direction.transpose();
  }
  return held;
}

}  // namespace

FreeGauge::FreeGauge(const ReducedSystem& system) {
  const FullVectors all = AllDirections(system);
  const Eigen::MatrixXd free = FindFree(SumUp(system, all));
  const Eigen::Index degrees = free.cols();
  const auto num_unknowns = static_cast<Eigen::Index>(system.num_unknowns());
  const Eigen::Index num_coordinates = 3 * Eigen::Index{system.problem().num_points};
  n_.num_columns = static_cast<int>(degrees);
  n_.cameras.resize(static_cast<size_t>(num_unknowns * degrees));
  n_.points.resize(static_cast<size_t>(num_coordinates * degrees));
  Columns cameras(n_.cameras.data(), num_unknowns, degrees);
  Columns points(n_.points.data(), num_coordinates, degrees);
  cameras = Multiply(ConstMap(all.cameras.data(), num_unknowns, kCount), free);
  points = Multiply(ConstMap(all.points.data(), num_coordinates, kCount), free);
  // What nothing says of a point is no part of the world's freedom.
  for (const NullPoint& null : system.null_points()) {
    points.middleRows(3 * Eigen::Index{null.point}, 3) =
        (Eigen::Matrix3d::Identity() - Eigen::Map<const Eigen::Matrix3d>(null.projector)) *
        points.middleRows(3 * Eigen::Index{null.point}, 3);
  }
  const Eigen::MatrixXd inverse =
      InverseOfCholesky(MultiplyTransposed(cameras, cameras) + MultiplyTransposed(points, points));
  cameras = Multiply(cameras, inverse);
  points = Multiply(points, inverse);
}

void FreeGauge::Hold(ReducedSystem* system) const {
  const BlockStructure& s = system->structure();
  const std::vector<double>& diagonal = system->diagonal();
  if (s.dense) {
    const auto size = static_cast<Eigen::Index>(diagonal.size());
    const Eigen::VectorXd root =
        Eigen::Map<const Eigen::VectorXd>(diagonal.data(), size).cwiseMax(0).cwiseSqrt();
    const Eigen::MatrixXd scaled =
        root.asDiagonal() * Eigen::Map<const Eigen::MatrixXd>(n_.cameras.data(), size, degrees());
    const Eigen::MatrixXd b = root.asDiagonal() * OrthonormalColumns(scaled);
    Columns(system->values().data(), size, size) += Multiply(b, b.transpose());
    return;
  }
  for (const int unknown : ChooseHeld(n_, diagonal)) {
    const int block = s.BlockOf(unknown);
    const int k = unknown - s.offset[block];
    system->values()[s.ValueIndex(block, s.Entry(block, block), k, k)] += diagonal[unknown];
  }
}

}  // namespace bundle
