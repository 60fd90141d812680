#include "core/fused/eliminate/schur_problem.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "core/fused/reduced/reduced_solver.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/solve/prepare.h"
#include "support/normal_equations.h"
#include "support/scene.h"

namespace bundle::fused {
namespace {

using testing::Damping;
using testing::EliminatedEquations;
using testing::LinearizedProblem;
using testing::MakeScene;
using testing::Real;
using testing::RealMatrix;
using testing::RealVector;
using testing::Scene;
using testing::SceneOptions;

/// Keeps the system that it is to solve, and solves it in extended precision.
class CapturingSolver final : public ReducedSolver {
 public:
  explicit CapturingSolver(ReducedStructure structure) : structure_(std::move(structure)) {}

  ReducedSolution Solve(ReducedSystem* system, const std::vector<double>& scale, double /*eta*/,
                        double* x) override {
    const int n = structure_.num_blocks() == 0 ? 0 : structure_.num_columns();
    scale_ = scale;
    matrix = RealMatrix::Zero(n, n);
    camera_diagonal = RealMatrix::Zero(n, n);
    rhs.resize(n);
    for (int i = 0; i < n; ++i) rhs[i] = system->rhs[i];
    int64_t diagonal_at = 0;
    for (int j = 0; j < structure_.num_blocks(); ++j) {
      const int columns = structure_.block_size(j), left = structure_.offset[j];
      for (int64_t e = structure_.column_begin[j]; e < structure_.column_begin[j + 1]; ++e) {
        const int block = structure_.row_block[e], top = structure_.offset[block];
        for (int r = 0; r < structure_.block_size(block); ++r) {
          for (int c = 0; c < columns; ++c) {
            if (top + r < left + c) continue;  // only the lower triangle means anything
            const double value = system->values[structure_.ValueIndex(j, e, r, c)];
            matrix(top + r, left + c) = matrix(left + c, top + r) = value;
          }
        }
      }
      for (int c = 0; c < columns; ++c) {
        for (int r = 0; r < columns; ++r) {
          camera_diagonal(left + r, left + c) = system->camera_diagonal.at(diagonal_at++);
        }
      }
    }
    const RealVector solution = n > 0 ? RealVector(matrix.ldlt().solve(rhs)) : RealVector();
    for (int i = 0; i < n; ++i) x[i] = static_cast<double>(solution[i]);
    return {};
  }
  bool NeedsCameraDiagonal() const override { return true; }

  const std::vector<double>& scale() const { return scale_; }

  RealMatrix matrix, camera_diagonal;
  RealVector rhs;

 private:
  const ReducedStructure structure_;
  std::vector<double> scale_;
};

ReducedStructure Structure(const ProblemView& problem, const ParameterLayout& layout, bool dense) {
  std::vector<int> sizes;
  for (const CameraSideBlock& block : layout.blocks()) sizes.push_back(block.size);
  return dense ? DenseStructure(sizes) : SparseStructure(sizes, FindCoupledBlocks(problem, layout));
}

void ExpectNear(double found, Real expected, Real tolerance, const char* what) {
  EXPECT_NEAR(found, static_cast<double>(expected), static_cast<double>(tolerance)) << what;
}

/// A SchurProblem next to the same in extended precision.
class Comparison {
 public:
  Comparison(const Scene& scene, const SolveOptions& options, bool dense = true)
      : problem_(scene.View()),
        options_(options),
        prepared_(PrepareSolve(problem_, options)),
        solver_(Structure(problem_, layout(), dense)),
        schur_(problem_, layout(), options, Structure(problem_, layout(), dense), &solver_),
        first_(problem_, layout(), options, CameraStates(problem_, layout()), scene.points),
        damping_(first_) {}

  const ParameterLayout& layout() const { return prepared_.layout; }

  /// Linearises at the state that the problem is in, and compares all that comes of it.
  void Check(double damping) {
    const LinearizedProblem expected(problem_, layout(), options_, schur_.cameras(),
                                     schur_.Points());
    const RealVector d_squared = damping_.SquaredD(expected);
    const EliminatedEquations equations(expected, d_squared, damping);
    const Linearization found = schur_.Linearize(damping);
    ASSERT_EQ(schur_.SolveNewton(0.1).status, NewtonResult::Status::kSuccess);
    CheckLinearization(found, expected);
    CheckSystem(equations, expected);
    const RealVector q = equations.Solve();
    const RealVector p = expected.gradient.cwiseQuotient(d_squared);
    CheckNewtonCandidate(expected, q);
    CheckProducts(expected, d_squared, p, q);
    CheckCombination(expected, p, q);
  }

  /// Goes to the candidate of the last Newton direction.
  void Step() {
    const Candidate candidate = schur_.TryNewton();
    schur_.Accept();
    const LinearizedProblem there(problem_, layout(), options_, schur_.cameras(), schur_.Points());
    ExpectNear(candidate.cost, there.cost, 1e-11L * there.cost, "cost of the candidate");
    ExpectNear(schur_.StateNorm(), StateNorm(), 1e-13L * StateNorm(), "norm of the state");
  }

 private:
  void CheckLinearization(const Linearization& found, const LinearizedProblem& expected) const {
    EXPECT_TRUE(found.is_finite);
    EXPECT_EQ(schur_.num_active_observations(), expected.num_active);
    ExpectNear(found.cost, expected.cost, 1e-13L * expected.cost, "cost");
    ExpectNear(schur_.fixed_cost(), expected.fixed_cost, 1e-13L * expected.fixed_cost,
               "fixed cost");
    const Real norm = expected.gradient.norm();
    ExpectNear(found.gradient_norm, norm, 1e-12L * norm, "gradient");
    const Real max = expected.num_columns > 0 ? expected.gradient.cwiseAbs().maxCoeff() : 0;
    ExpectNear(found.gradient_max_norm, max, 1e-12L * norm, "gradient's largest entry");
  }

  void CheckSystem(const EliminatedEquations& expected, const LinearizedProblem& problem) const {
    const int n = problem.num_camera_columns;
    ASSERT_EQ(solver_.matrix.rows(), n);
    const RealVector size = expected.camera.diagonal().cwiseSqrt();
    const Real residual_norm = std::sqrt(2 * problem.cost) + 1e-300L;
    Real worst_matrix = 0, worst_diagonal = 0, worst_rhs = 0;
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const Real scale = size[i] * size[j];
        worst_matrix =
            std::max(worst_matrix, std::abs(solver_.matrix(i, j) - expected.reduced(i, j)) / scale);
        if (solver_.camera_diagonal(i, j) == 0) continue;  // of another block
        worst_diagonal =
            std::max(worst_diagonal,
                     std::abs(solver_.camera_diagonal(i, j) - expected.camera(i, j)) / scale);
      }
      EXPECT_NE(solver_.camera_diagonal(j, j), 0);
      worst_rhs = std::max(worst_rhs,
                           std::abs(solver_.rhs[j] - expected.rhs[j]) / (size[j] * residual_norm));
      const Real scale = std::sqrt(damping_.squared_scale()[j]);
      ExpectNear(solver_.scale()[j], scale, 1e-13L * scale, "Jacobi scaling");
    }
    EXPECT_LE(worst_matrix, 1e-12L) << "S";
    EXPECT_LE(worst_diagonal, 1e-12L) << "block diagonal of the camera side";
    EXPECT_LE(worst_rhs, 1e-12L) << "b";
  }

  static Real ModelCostChange(const LinearizedProblem& problem, const RealVector& step) {
    const Real along = problem.gradient.dot(step);
    return -along - problem.JacobianTimes(step).squaredNorm() / 2;
  }

  void CheckNewtonCandidate(const LinearizedProblem& expected, const RealVector& q) {
    const Candidate candidate = schur_.TryNewton();
    const Real change = ModelCostChange(expected, q);
    ExpectNear(candidate.model_cost_change, change, 1e-9L * change, "model cost change");
    ExpectNear(candidate.step_norm, q.norm(), 1e-7L * q.norm(), "step");
  }

  void CheckProducts(const LinearizedProblem& expected, const RealVector& d_squared,
                     const RealVector& p, const RealVector& q) {
    const DirectionProducts found = schur_.Products();
    const RealVector dp = d_squared.cwiseProduct(p), dq = d_squared.cwiseProduct(q);
    const RealVector jp = expected.JacobianTimes(p), jq = expected.JacobianTimes(q);
    const Real d_pp = p.dot(dp), d_qq = q.dot(dq), j_pp = jp.squaredNorm(), j_qq = jq.squaredNorm();
    ExpectNear(found.d_pp, d_pp, 1e-11L * d_pp, "p D^2 p");
    ExpectNear(found.d_pq, p.dot(dq), 1e-7L * std::sqrt(d_pp * d_qq), "p D^2 q");
    ExpectNear(found.d_qq, d_qq, 1e-7L * d_qq, "q D^2 q");
    ExpectNear(found.j_pp, j_pp, 1e-11L * j_pp, "p J^T J p");
    ExpectNear(found.j_pq, jp.dot(jq), 1e-7L * std::sqrt(j_pp * j_qq), "p J^T J q");
    ExpectNear(found.j_qq, j_qq, 1e-7L * j_qq, "q J^T J q");
    const Real g_p = expected.gradient.dot(p), g_q = expected.gradient.dot(q);
    ExpectNear(found.g_p, g_p, 1e-11L * g_p, "p J^T r");
    ExpectNear(found.g_q, g_q, 1e-9L * std::abs(g_q), "q J^T r");
  }

  void CheckCombination(const LinearizedProblem& expected, const RealVector& p,
                        const RealVector& q) {
    // As a dogleg's: a step against the gradient, and part of Newton's.
    const Real a = -p.dot(expected.gradient) / (expected.JacobianTimes(p).squaredNorm() + 1e-300L);
    const auto rounded = static_cast<double>(0.3L * a);
    const RealVector step = rounded * p + 0.7L * q;
    const Candidate candidate = schur_.TryCombination(rounded, 0.7);
    const Real change = ModelCostChange(expected, step);
    ExpectNear(candidate.model_cost_change, change, 1e-8L * std::abs(change),
               "model cost change of a combination");
    ExpectNear(candidate.step_norm, step.norm(), 1e-7L * step.norm(), "step of a combination");
  }

  /// ||x|| over all that is refined.
  Real StateNorm() const {
    Real sum = 0;
    const std::vector<double> quaternions = schur_.cameras().CamFromWorld();
    const std::vector<double> points = schur_.Points();
    for (int i = 0; i < problem_.num_images; ++i) {
      AddSquares(layout().image_block(i), i, problem_.image_camera[i], quaternions, &sum);
    }
    for (int c = 0; c < problem_.num_cameras; ++c) {
      AddSquares(layout().camera_block(c), -1, c, quaternions, &sum);
    }
    for (int i = 0; i < 3 * problem_.num_points; ++i) {
      if (layout().point_is_free(i / 3)) sum += Real(points[i]) * points[i];
    }
    return std::sqrt(sum);
  }

  void AddSquares(int index, int image, int camera, const std::vector<double>& quaternions,
                  Real* sum) const {
    if (index < 0) return;
    const CameraSideBlock& block = layout().blocks()[index];
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      Real value;
      if (column < 3) {
        value = RotationVector(image, quaternions)[column];
      } else if (column < kPoseSize) {
        value = quaternions[7 * static_cast<size_t>(image) + 4 + column - 3];
      } else {
        value = schur_.cameras().params(camera)[column - kPoseSize];
      }
      *sum += value * value;
    }
  }

  /// w of Exp(w) q0 = q.
  RealVector RotationVector(int image, const std::vector<double>& quaternions) const {
    const double* start = problem_.cam_from_world + 7 * static_cast<int64_t>(image);
    const double inverse[4] = {-start[0], -start[1], -start[2], start[3]};
    double w[4];
    QuaternionProduct(&quaternions[7 * static_cast<size_t>(image)], inverse, w);
    RealVector vector(3);
    vector << w[0], w[1], w[2];
    const Real sine = vector.norm();
    return sine == 0 ? vector : RealVector(vector * (2 * std::atan2(sine, Real(w[3])) / sine));
  }

  const ProblemView problem_;
  const SolveOptions options_;
  const PreparedSolve prepared_;
  CapturingSolver solver_;
  SchurProblem schur_;
  const LinearizedProblem first_;
  const Damping damping_;
};

SceneOptions SmallScene() {
  SceneOptions options;
  options.num_images = 4;
  options.num_points = 14;
  options.track_length = 3;
  options.outlier_share = 0.1;
  return options;
}

SolveOptions Options() {
  SolveOptions options;
  options.loss_scale = 5;
  options.num_threads = 2;
  return options;
}

/// At the start, again with another damping, and after a step.
void CheckAlongTheWay(Comparison* comparison) {
  comparison->Check(1e-4);
  comparison->Check(1e2);
  comparison->Step();
  comparison->Check(1e-3);
}

class SchurProblemTest : public ::testing::TestWithParam<int> {};

TEST_P(SchurProblemTest, EqualsDenseAlgebraInExtendedPrecision) {
  for (const int images_per_camera : {1, 2, 4}) {
    SceneOptions scene_options = SmallScene();
    scene_options.model = AllCameraModels()[GetParam()].name;
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (const auto& [name, loss] : kLossTypes) {
      SCOPED_TRACE(::testing::Message() << name << ", " << images_per_camera);
      SolveOptions options = Options();
      options.loss = loss;
      options.refine_principal_point = images_per_camera == 2;
      Comparison comparison(scene, options, images_per_camera != 4);
      CheckAlongTheWay(&comparison);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, SchurProblemTest, ::testing::Range(0, kNumCameraModels),
                         [](const auto& test) { return AllCameraModels()[test.param].name; });

TEST(SchurProblem, WhateverIsFixed) {
  SceneOptions scene_options = SmallScene();
  for (const int images_per_camera : {1, 2}) {
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (int bits = 1; bits < 64; ++bits) {
      SCOPED_TRACE(::testing::Message() << bits << ", " << images_per_camera);
      SolveOptions options = Options();
      options.refine_poses = bits & 1;
      options.refine_points = bits & 2;
      options.refine_focal = bits & 4;
      options.refine_principal_point = bits & 8;
      options.refine_extra = bits & 16;
      if (bits & 32) {
        options.fixed_image_ids = {scene.image_ids[0], scene.image_ids[2]};
        options.fixed_camera_ids = {scene.camera_ids[0]};
        options.fixed_point_ids.assign(scene.point_ids.begin(), scene.point_ids.begin() + 7);
      }
      Comparison comparison(scene, options, bits % 3 != 0);
      CheckAlongTheWay(&comparison);
    }
  }
}

TEST(SchurProblem, EveryGauge) {
  for (const auto& [name, gauge] : kGauges) {
    SCOPED_TRACE(name);
    SolveOptions options = Options();
    options.gauge = gauge;
    const Scene scene = MakeScene(SmallScene());
    Comparison comparison(scene, options);
    CheckAlongTheWay(&comparison);
  }
}

TEST(SchurProblem, UglyScenes) {
  std::vector<Scene> scenes(8, MakeScene(SmallScene()));
  testing::RepeatObservations(3, &scenes[0]);
  testing::RepeatObservations(1, &scenes[1]);
  testing::ShuffleObservations(3, &scenes[1]);
  testing::PutPointsBehind(3, &scenes[2]);
  testing::PutPointsBehind(1, &scenes[3]);
  testing::AddUnobserved(&scenes[4]);
  SceneOptions fisheye = SmallScene();
  fisheye.model = "OPENCV_FISHEYE";
  fisheye.images_per_camera = 4;
  testing::Append(MakeScene(fisheye), &scenes[5]);  // two models, own and shared intrinsics
  SceneOptions once = SmallScene();
  once.track_length = 1;
  testing::Append(MakeScene(once), &scenes[6]);  // points seen once
  SceneOptions one_image = SmallScene();
  one_image.num_images = 1;
  scenes[7] = MakeScene(one_image);
  int index = 0;
  for (const Scene& scene : scenes) {
    for (const auto& [name, cheirality] : kCheiralities) {
      for (const bool dense : {true, false}) {
        SCOPED_TRACE(::testing::Message() << "scene " << index << " " << name << " " << dense);
        SolveOptions options = Options();
        options.cheirality = cheirality;
        options.loss = LossType::kCauchy;
        Comparison comparison(scene, options, dense);
        comparison.Check(1e-2);
        comparison.Check(1);
      }
    }
    ++index;
  }
}

/// So many images see a point that it is spread over several chunks, and there are several of
/// those for each thread.
TEST(SchurProblem, LongTracksAndManyChunks) {
  SceneOptions scene_options;
  scene_options.num_images = 40;
  scene_options.num_points = 60;
  for (const int images_per_camera : {1, 40}) {
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (const int threads : {1, 3}) {
      SCOPED_TRACE(::testing::Message() << images_per_camera << " " << threads);
      SolveOptions options = Options();
      options.num_threads = threads;
      options.refine_principal_point = true;
      Comparison comparison(scene, options);
      comparison.Check(1e-3);
    }
  }
}

}  // namespace
}  // namespace bundle::fused
