/// Passes over several edges at a time, against one edge at a time in doubles.

#include "core/pose_graph/kernels/edge_kernels.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "core/pose_graph/edge_kernel.h"

namespace bundle {
namespace {

/// Edges between random poses, whose residuals have angles from 0 to pi.
template <typename Group>
struct RandomEdges {
  std::vector<double> poses, measurements, information;
  std::vector<int32_t> ends;
  std::vector<int64_t> edges;
  PoseGraphEdges prepared;
  std::vector<double> records;

  explicit RandomEdges(int count) {
    std::mt19937 random(7);
    std::normal_distribution<double> normal;
    constexpr int kSize = Group::kTangent;
    const Retraction retraction(Group::kManifold, Group::kAmbient);
    const auto any_pose = [&] {
      std::vector<double> pose(Group::kAmbient);
      for (double& value : pose) value = 2 * normal(random);
      retraction.Normalize(pose.data());
      return pose;
    };
    for (int e = 0; e < count; ++e) {
      const std::vector<double> from = any_pose(), z = any_pose();
      // The second pose where the measurement has it, moved by up to half a turn.
      std::vector<double> identity(Group::kAmbient, 0.0), inverse(Group::kAmbient),
          there(Group::kAmbient), to(Group::kAmbient), step(kSize);
      if (kSize == 6) identity[3] = 1;
      retraction.Between(from.data(), identity.data(), inverse.data());
      retraction.Between(inverse.data(), z.data(), there.data());
      const double size = e % 5 == 0 ? 0 : std::pow(10, -8.0 + 8.5 * e / count);
      for (double& value : step) value = size * normal(random);
      retraction.Plus(there.data(), step.data(), to.data());
      poses.insert(poses.end(), from.begin(), from.end());
      poses.insert(poses.end(), to.begin(), to.end());
      measurements.insert(measurements.end(), z.begin(), z.end());
      ends.insert(ends.end(), {2 * e, 2 * e + 1});
      edges.push_back(e);
      std::vector<double> root(kSize * kSize);
      for (double& value : root) value = normal(random);
      for (int r = 0; r < kSize; ++r) {
        for (int c = 0; c < kSize; ++c) {
          double sum = r == c ? 1 : 0;
          for (int k = 0; k < kSize; ++k) sum += root[r * kSize + k] * root[c * kSize + k];
          information.push_back(sum);
        }
      }
    }
    prepared = PrepareEdges(kSize == 3 ? 2 : 3, 2 * count, count, ends.data(), measurements.data(),
                            information.data());
    records = PoseRecords<Group>(poses);
  }

  EdgeArrays Arrays(PoseError error) const {
    return {error, prepared.ends.data(), records.data(), prepared.records.data(),
            prepared.roots.data()};
  }
};

template <typename Group>
class EdgeKernelsTest : public testing::Test {};
using Groups = testing::Types<Se2, Se3>;
TYPED_TEST_SUITE(EdgeKernelsTest, Groups, );  // clang wants the third argument

TYPED_TEST(EdgeKernelsTest, EqualOneEdgeAtATime) {
  using Terms = EdgeTerms<TypeParam>;
  constexpr int kRecord = TypeParam::kRecord, kNumbers = Terms::kNumbers;
  const int count = 403;
  const RandomEdges<TypeParam> given(count);
  ASSERT_TRUE(given.prepared.bad.empty());
  for (const PoseError error : {PoseError::kLog, PoseError::kG2o, PoseError::kCeres}) {
    const EdgeArrays arrays = given.Arrays(error);
    std::vector<double> terms(count * kNumbers), chi2(count);
    SelectEdgeKernels<TypeParam>().linearize(arrays, given.edges.data(), count, terms.data());
    SelectEdgeKernels<TypeParam>().chi2(arrays, given.edges.data(), count, chi2.data());
    for (int e = 0; e < count; ++e) {
      double expected[kNumbers] = {};
      LinearizeEdge<TypeParam>(error, arrays.poses + 2 * e * kRecord,
                               arrays.poses + (2 * e + 1) * kRecord,
                               arrays.measurements + e * kRecord,
                               arrays.roots + e * RootSize(TypeParam::kTangent), expected);
      double largest = 0;
      for (const double value : expected) largest = std::max(largest, std::abs(value));
      for (int k = 0; k < kNumbers; ++k) {
        EXPECT_NEAR(terms[e * kNumbers + k], expected[k], 2e-13 * largest) << e << " " << k;
      }
      // Residuals have the rounding errors of poses of size 1.
      const double norm = std::sqrt(expected[Terms::kChi2]);
      EXPECT_NEAR(std::sqrt(chi2[e]), norm, 1e-13 * (1 + norm)) << e;
    }
  }
}

TYPED_TEST(EdgeKernelsTest, AnyDivisionGivesTheSameBits) {
  constexpr int kNumbers = EdgeTerms<TypeParam>::kNumbers;
  const int count = 61;
  const RandomEdges<TypeParam> given(count);
  const EdgeArrays arrays = given.Arrays(PoseError::kLog);
  const EdgeKernels<TypeParam>& kernels = SelectEdgeKernels<TypeParam>();
  std::vector<double> whole(count * kNumbers), parts(whole.size()), chi2(count), one(count);
  kernels.linearize(arrays, given.edges.data(), count, whole.data());
  kernels.chi2(arrays, given.edges.data(), count, chi2.data());
  for (int e = 0; e < count; ++e) {
    kernels.linearize(arrays, given.edges.data() + e, 1, parts.data() + e * kNumbers);
    kernels.chi2(arrays, given.edges.data() + e, 1, one.data() + e);
  }
  EXPECT_EQ(whole, parts);
  EXPECT_EQ(chi2, one);
}

TEST(EdgeKernels, PlanarRecordsHaveCosinesAndSinesToRounding) {
  constexpr double kPi = 3.141592653589793;
  std::vector<double> angles = {0, 1e-300, 1e-9, 0.7853981, 0.7853982, 999999.9, 1000000.1, 1e300};
  for (int quarter = 0; quarter <= 8; ++quarter) angles.push_back(quarter * kPi / 2);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> exponent(-3, 11);
  while (angles.size() < 1000) angles.push_back(std::pow(10, exponent(random)));
  std::vector<double> poses, records(2 * angles.size() * Se2::kRecord);
  for (const double angle : angles) poses.insert(poses.end(), {1, 2, angle, 3, 4, -angle});
  const auto count = static_cast<int64_t>(2 * angles.size());
  SelectEdgeKernels<Se2>().records(poses.data(), count, records.data());
  for (int64_t i = 0; i < count; ++i) {
    const double *const pose = &poses[3 * i], *const record = &records[i * Se2::kRecord];
    for (int k = 0; k < 3; ++k) EXPECT_EQ(record[k], pose[k]);
    EXPECT_NEAR(record[3], std::cos(pose[2]), 2.3e-16) << pose[2];
    EXPECT_NEAR(record[4], std::sin(pose[2]), 2.3e-16) << pose[2];
    double one[Se2::kRecord];
    SelectEdgeKernels<Se2>().records(pose, 1, one);
    for (int k = 0; k < Se2::kRecord; ++k) EXPECT_EQ(record[k], one[k]);
  }
}

}  // namespace
}  // namespace bundle
