/// Part of AdjointComputation (adjoint_computation.h): the factor of the exact Hessian, with the
/// points eliminated (adjoint.h has the mathematics).

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/covariance/adjoint_computation.h"
#include "core/covariance/sandwich.h"
#include "core/covariance/symmetric_sum.h"
#include "core/factors/reprojection.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// Relative step of the differences of dr/dz.
constexpr double kStep = 1e-5;

/// z: P, then the local columns of an image after those of its pose.
constexpr int kFirstOfZ = kPoseSize - 3;
constexpr int kSizeOfZ = kImageColumns - kFirstOfZ;

/// sum_k u_k d2r_k of an observation, by the local columns of its image and by its point.
struct Curvature {
  Eigen::Matrix<double, kImageColumns, kImageColumns> cameras;
  Eigen::Matrix<double, kImageColumns, 3> mixed;
  Eigen::Matrix3d point;
};

/// The residual of an observation as a function of z.
struct Projected {
  const CameraModel& model;
  const double* xy;
  Cheirality cheirality;
  const ImageShutter* shutter;
  Eigen::Vector2d u;

  /// u^T dr/dz; zero if the observation does not count.
  Eigen::Matrix<double, kSizeOfZ, 1> Slope(const Eigen::Matrix<double, kSizeOfZ, 1>& z) const {
    static constexpr PoseState kNone = {
        {1, 0, 0, 0, 1, 0, 0, 0, 1}, {}, {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    Eigen::Matrix<double, kSizeOfZ, 1> slope = Eigen::Matrix<double, kSizeOfZ, 1>::Zero();
    ImageShutter moved{};
    if (shutter != nullptr) {
      moved = *shutter;
      std::copy_n(z.data() + kFirstTwist - kFirstOfZ, kTwistSize, moved.twist);
    }
    double residual[2];
    ReprojectionJacobian j;
    if (!EvaluateReprojection(model, kNone, z.data() + 3, z.data(), xy, cheirality, residual, &j,
                              shutter == nullptr ? nullptr : &moved)) {
      return slope;
    }
    const auto add = [&](const double* rows, int size, int to) {
      for (int k = 0; k < size; ++k) slope[to + k] = u[0] * rows[k] + u[1] * rows[size + k];
    };
    add(j.point, 3, 0);
    add(j.params, model.num_params, 3);
    if (shutter != nullptr) add(j.twist, kTwistSize, kFirstTwist - kFirstOfZ);
    return slope;
  }
};

/// M^T x, for rows x by local columns.
template <typename Local>
auto ByUnknowns(const LocalMap& map, const Local& local) {
  Eigen::Matrix<double, Eigen::Dynamic, Local::ColsAtCompileTime, 0, BlockSystem::kMaxBlockSize,
                Local::MaxColsAtCompileTime>
      found(map.size, local.cols());
  if (!map.values.empty()) found.setZero();
  for (size_t i = 0; i < map.columns.size(); ++i) {
    if (map.values.empty()) found.row(static_cast<int>(i)) = local.row(map.columns[i]);
    for (int k = 0; k < map.size && !map.values.empty(); ++k) {
      found.row(k) += map.values[i * map.size + k] * local.row(map.columns[i]);
    }
  }
  return found;
}

Curvature CurvatureOf(const ReducedSystem& system, Cheirality cheirality,
                      const ObservationRows& rows) {
  const AdjustmentProblem& problem = system.problem();
  const int64_t i = rows.observation;
  const int image = problem.observation_image[i], camera = problem.image_camera[image];
  const CameraStates& states = system.states();
  const Eigen::Map<const Matrix3> rotation(states.pose(image).rotation);
  const Eigen::Map<const Eigen::Vector3d> x(problem.points +
                                            3 * int64_t{problem.observation_point[i]});
  const double sigma = problem.observation_sigma == nullptr ? 1 : problem.observation_sigma[i];
  const Projected projected{
      *problem.camera_models[camera], problem.observation_xy + 2 * i, cheirality,
      states.shutter(image),
      std::sqrt(rows.weight) / sigma * Eigen::Map<const Eigen::Vector2d>(rows.residual)};
  const Eigen::Vector3d q = rotation * x;
  Eigen::Matrix<double, kSizeOfZ, 1> z = Eigen::Matrix<double, kSizeOfZ, 1>::Zero();
  z.head<3>() = q + Eigen::Map<const Eigen::Vector3d>(states.pose(image).translation);
  std::copy_n(states.params(camera), projected.model.num_params, z.data() + 3);
  if (projected.shutter != nullptr) {
    std::copy_n(projected.shutter->twist, kTwistSize, z.data() + kFirstTwist - kFirstOfZ);
  }
  const double distance = z.head<3>().norm();
  Eigen::Matrix<double, kSizeOfZ, kSizeOfZ> t = Eigen::Matrix<double, kSizeOfZ, kSizeOfZ>::Zero();
  const auto differentiate = [&](int column) {
    const bool is_length = column < 3 || column >= kSizeOfZ - 3;
    const double at = z[column],
                 step = kStep * (is_length ? distance : std::max(1.0, std::abs(at)));
    z[column] = at + step;
    t.col(column) = projected.Slope(z);
    z[column] = at - step;
    t.col(column) = (t.col(column) - projected.Slope(z)) / (2 * step);
    z[column] = at;
  };
  for (int k = 0; k < 3; ++k) differentiate(k);
  uint32_t done = 0;
  for (const LocalMap& map : system.evaluator().maps(image)) {
    for (const int column : map.columns) {
      if (column < kPoseSize || (done >> column & 1) != 0) continue;
      done |= uint32_t{1} << column;
      differentiate(column - kFirstOfZ);
      t.row(column - kFirstOfZ).head<3>() = t.col(column - kFirstOfZ).head<3>();
    }
  }
  // P = Exp(w) q + t.
  const Eigen::Vector3d slope = projected.Slope(z).head<3>();
  const auto skew = [](const Eigen::Vector3d& v) {
    Eigen::Matrix3d m;
    m << 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0;
    return m;
  };
  Eigen::Matrix<double, 3, kPoseSize> by_pose;
  by_pose << -skew(q), Eigen::Matrix3d::Identity();
  Curvature c;
  c.cameras.setZero();
  constexpr int kRest = kImageColumns - kPoseSize;
  const auto tpp = t.topLeftCorner<3, 3>();
  c.cameras.bottomRightCorner<kRest, kRest>() = t.bottomRightCorner<kRest, kRest>();
  c.cameras.topRightCorner<kPoseSize, kRest>() =
      by_pose.transpose().lazyProduct(t.topRightCorner<3, kRest>());
  c.cameras.bottomLeftCorner<kRest, kPoseSize>() =
      c.cameras.topRightCorner<kPoseSize, kRest>().transpose();
  const Eigen::Matrix<double, 3, kPoseSize> moved = tpp * by_pose;
  c.cameras.topLeftCorner<kPoseSize, kPoseSize>() = by_pose.transpose() * moved;
  const Eigen::Matrix3d turn = slope * q.transpose();
  c.cameras.topLeftCorner<3, 3>() +=
      0.5 * (turn + turn.transpose()) - turn.trace() * Eigen::Matrix3d::Identity();
  c.mixed.topRows<kPoseSize>() = moved.transpose() * rotation;
  c.mixed.topRows<3>() -= skew(slope) * rotation;
  c.mixed.bottomRows<kRest>() = t.bottomLeftCorner<kRest, 3>() * rotation;
  c.point = rotation.transpose() * tpp * rotation;
  return c;
}

/// Adds the curvature, and beta J~^T r~ r~^T J~, to the blocks of cameras.
void AddSecond(const std::vector<LocalMap>& maps, const Curvature& c, const ObservationRows& rows,
               SymmetricSum* sum) {
  sum->AddOwn(rows, 1, rows.bend);
  for (const LocalMap& b : maps) {
    const auto columns = ByUnknowns(b, c.cameras).transpose().eval();
    for (const LocalMap& a : maps) {
      if (a.block < b.block) continue;
      const auto block = ByUnknowns(a, columns);
      sum->Add(a.block, b.block, [&](int r, int k) { return block(r, k); });
    }
  }
}

/// Adds them to V and W.
void AddToPoint(const std::vector<LocalMap>& maps, const Curvature& c, const ObservationRows& rows,
                PointBlocks* blocks) {
  double of_point[3], share[BlockSystem::kMaxBlockSize];
  PointShare(rows, of_point);
  for (int k = 0; k < 9; ++k) {
    blocks->v[k] += c.point(k / 3, k % 3) + rows.bend * of_point[k / 3] * of_point[k % 3];
  }
  for (int b = 0; b < rows.num_blocks; ++b) {
    ShareOf(rows, b, share);
    const auto second = ByUnknowns(maps[b], c.mixed);
    const auto at = std::lower_bound(blocks->blocks.begin(), blocks->blocks.end(), rows.block[b]);
    double* to = &blocks->w[3 * size_t(blocks->begin[at - blocks->blocks.begin()])];
    for (int r = 0; r < rows.size[b]; ++r, to += 3) {
      for (int k = 0; k < 3; ++k) to[k] += second(r, k) + rows.bend * share[r] * of_point[k];
    }
  }
}

/// V^-1 and W V^-1 without the null directions of J~^T J~. False if V is not positive definite.
bool InvertPoint(PointBlocks* blocks) {
  const Eigen::Map<const Matrix3> null(blocks->null_projector);
  const Matrix3 rest = Matrix3::Identity() - null;
  const double largest = blocks->largest > 0 ? blocks->largest : 1;  // without a ray
  const Matrix3 v = rest * Eigen::Map<const Matrix3>(blocks->v) * rest + largest * null;
  const Eigen::LLT<Matrix3> factor(v);
  if (factor.info() != Eigen::Success) return false;
  Eigen::Map<Matrix3> inverse(blocks->inverse);
  inverse = factor.solve(rest);
  inverse = (rest * inverse).eval();
  const auto rows = static_cast<Eigen::Index>(blocks->w.size() / 3);
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  Eigen::Map<Rows>(blocks->y.data(), rows, 3) =
      Eigen::Map<const Rows>(blocks->w.data(), rows, 3).lazyProduct(inverse);
  return true;
}

}  // namespace

/// False, with the system as before, if the Hessian is not positive definite.
bool AdjointComputation::FactorizeExactly() {
  ReducedSystem& system = computation_.system_;
  const ObservationEvaluator& evaluator = system.evaluator();
  const auto maps = [&](const ObservationRows& rows) -> const std::vector<LocalMap>& {
    return evaluator.maps(all_.observation_image[rows.observation]);
  };
  BlockValues values(static_cast<size_t>(system.structure().num_values), 0.0);
  SymmetricSum sum(system.structure(), &values);
  bool is_definite = true;
  PointBlocks own;
  system.ForPoints(1, [&](int p, const PointBlocks& blocks, const PointAssembler& rows, int) {
    if (!is_definite) return;
    own = blocks;
    for (int i = 0; i < rows.num_rows(); ++i) {
      const Curvature c = CurvatureOf(system, options_.cheirality, rows.row(i));
      AddSecond(maps(rows.row(i)), c, rows.row(i), &sum);
      AddToPoint(maps(rows.row(i)), c, rows.row(i), &own);
    }
    is_definite = InvertPoint(&own);
    if (!is_definite) return;
    sum.SubtractEliminated(own);
    Eliminated kept{p, kept_blocks_.size(), kept_y_.size(), {}};
    std::copy_n(own.inverse, 9, kept.inverse);
    kept_.push_back(kept);
    kept_blocks_.insert(kept_blocks_.end(), own.blocks.begin(), own.blocks.end());
    kept_y_.insert(kept_y_.end(), own.y.begin(), own.y.end());
  });
  if (is_definite) {
    system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
      AddSecond(maps(rows), CurvatureOf(system, options_.cheirality, rows), rows, &sum);
    });
    AddFactors(system, &values);
    system.SetSystem(std::move(values));
    computation_.HoldGauge();
    int unknown = 0;
    is_definite = system.Factorize().status == LinearStatus::kSuccess &&
                  system.SmallestPivot(&unknown) > CovarianceComputation::kSingular;
  }
  if (is_definite) return true;
  kept_ = {};
  kept_blocks_ = {};
  kept_y_ = {};
  system.SetSystem(SumBread(system));
  computation_.HoldGauge();
  computation_.Factorize();
  return false;
}

/// Calls visit(point, thread, first of Y) for what FactorizeExactly has kept.
template <typename Visit>
void AdjointComputation::ForKept(int num_threads, const Visit& visit) const {
  RunOnThreads(num_threads, [&](int64_t thread) {
    const auto count = static_cast<int64_t>(kept_.size());
    for (int64_t k = RangeBegin(count, num_threads, thread);
         k < RangeBegin(count, num_threads, thread + 1); ++k) {
      const Eliminated& kept = kept_[k];
      const size_t end = k + 1 < count ? kept_[k + 1].first_block : kept_blocks_.size();
      visit(kept, end, static_cast<int>(thread));
    }
  });
}

void AdjointComputation::Solve(const double* y, double* a) {
  const int n = num_unknowns();
  if (!is_exact_) {
    FullVectors rhs, found;
    rhs.num_columns = 1;
    rhs.cameras.assign(y, y + n);
    rhs.points.assign(y + n, y + size());
    computation_.Check(computation_.system_.Solve(rhs, &found));
    std::copy(found.cameras.begin(), found.cameras.end(), a);
    std::copy(found.points.begin(), found.points.end(), a + n);
    return;
  }
  const int num_threads = system().num_threads();
  const std::vector<int>& offset = system().structure().offset;
  std::vector<std::vector<double>> sums(num_threads);
  ForKept(num_threads, [&](const Eliminated& kept, size_t end, int thread) {
    std::vector<double>& sum = sums[thread];
    sum.resize(n);
    const double* const b = y + n + 3 * int64_t{kept.point};
    const double* of = kept_y_.data() + kept.first_row;
    for (size_t k = kept.first_block; k < end; ++k) {
      for (int j = offset[kept_blocks_[k]]; j < offset[kept_blocks_[k] + 1]; ++j, of += 3) {
        sum[j] += of[0] * b[0] + of[1] * b[1] + of[2] * b[2];
      }
    }
  });
  std::vector<double> reduced(y, y + n);
  for (const std::vector<double>& sum : sums) {
    for (size_t j = 0; j < sum.size(); ++j) reduced[j] -= sum[j];
  }
  ClearHeld(reduced.data());
  std::fill_n(a, size(), 0.0);
  computation_.Check(computation_.system_.Solve(reduced.data(), 1, a));
  ForKept(num_threads, [&](const Eliminated& kept, size_t end, int) {
    double* const to = a + n + 3 * int64_t{kept.point};
    VectorMatrix3(y + n + 3 * int64_t{kept.point}, kept.inverse, to);
    const double* of = kept_y_.data() + kept.first_row;
    for (size_t k = kept.first_block; k < end; ++k) {
      for (int j = offset[kept_blocks_[k]]; j < offset[kept_blocks_[k] + 1]; ++j, of += 3) {
        for (int i = 0; i < 3; ++i) to[i] -= of[i] * a[j];
      }
    }
  });
}

}  // namespace bundle
