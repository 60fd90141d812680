#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/solver/summarize_fused.h"

namespace bundle {
namespace {

/// Blocks of 2, 3 and 1; the first meets both others.
const std::vector<int> kSizes = {2, 3, 1};
const std::vector<std::vector<int>> kColumns = {{0, 1, 2}, {1}, {2}};

TEST(SummarizeFactor, CountsBothTrianglesOfTheSystem) {
  const FactorStatistics statistics{"amd", 20, 90, 20, 21};
  const FactorSummary sparse = SummarizeFactor(SparseStructure(kSizes, kColumns), statistics, 0.5);
  EXPECT_EQ(sparse.num_columns, 6);
  EXPECT_EQ(sparse.num_reduced_nonzeros, 4 + 9 + 1 + 2 * (6 + 2));
  EXPECT_EQ(sparse.num_nonzeros, 20);
  EXPECT_EQ(sparse.flops, 90);
  EXPECT_EQ(sparse.ordering, "amd");
  EXPECT_EQ(sparse.symbolic_time_in_seconds, 0.5);
  EXPECT_EQ(SummarizeFactor(DenseStructure(kSizes), statistics, 0).num_reduced_nonzeros, 36);
}

TEST(SummarizeFactor, LeavesOutWhatAnIterativeSolverHasNot) {
  const FactorSummary summary = SummarizeFactor(SparseStructure(kSizes, kColumns), {}, 0.5);
  EXPECT_EQ(summary.num_columns, std::nullopt);
  EXPECT_EQ(summary.num_nonzeros, std::nullopt);
  EXPECT_EQ(summary.flops, std::nullopt);
  EXPECT_EQ(summary.ordering, "");
  EXPECT_EQ(summary.num_reduced_nonzeros, 30);
}

TEST(FindSwollenFactor, SpeaksOfHalfAsMuchAgain) {
  FactorStatistics statistics{"metis", 1000, 0, 1000, 1500};
  EXPECT_EQ(FindSwollenFactor(statistics), "");
  statistics.stored = 2250;
  EXPECT_EQ(FindSwollenFactor(statistics),
            "The factor has 2250 entries, 2.2 times the 1000 that were predicted for its ordering, "
            "metis.");
  EXPECT_EQ(FindSwollenFactor({}), "");
}

}  // namespace
}  // namespace bundle
