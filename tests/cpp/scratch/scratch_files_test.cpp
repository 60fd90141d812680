#include "core/scratch/scratch_files.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include "core/error.h"
#include "core/scratch/large_vector.h"

namespace bundle {
namespace {

constexpr int64_t kMegabyte = 1 << 20;

/// The folder of this program, because that of temporary files may be in memory.
std::string Folder() { return std::filesystem::current_path().string(); }

class ScratchTest : public testing::Test {
 protected:
  void SetUp() override { OpenScratch(Folder(), kMegabyte); }
  void TearDown() override { CloseScratch(); }
};

TEST(ScratchFiles, WithoutAFolderArraysAreInMemory) {
  const LargeVector<double> values(1 << 20, 1.0);
  EXPECT_EQ(ScratchResidentBytes(), -1);
  EXPECT_EQ(MeasureScratch().bytes, 0);
}

TEST(ScratchFiles, RefusesMissingFolders) {
  EXPECT_THROW(OpenScratch("/no/such/folder", kMegabyte), InputError);
  EXPECT_EQ(ScratchResidentBytes(), -1);
}

TEST_F(ScratchTest, RefusesASecondFolder) {
  EXPECT_THROW(OpenScratch(Folder(), kMegabyte), InputError);
}

TEST_F(ScratchTest, KeepsValuesOfManySizesAndFreesAll) {
  {
    std::vector<LargeVector<int64_t>> vectors;
    for (const size_t size : {1, 500, 513, 4000, 100000, 2000000}) {
      vectors.emplace_back(size);
      std::iota(vectors.back().begin(), vectors.back().end(), static_cast<int64_t>(size));
    }
    vectors.erase(vectors.begin() + 3);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));  // pages are dropped
    for (const LargeVector<int64_t>& values : vectors) {
      for (size_t k = 0; k < values.size(); ++k) {
        ASSERT_EQ(values[k], static_cast<int64_t>(values.size() + k));
      }
    }
    EXPECT_GE(MeasureScratch().bytes, 16 * 1000 * 1000);
  }
  CloseScratch();
  EXPECT_EQ(MeasureScratch().bytes, 0);
  OpenScratch(Folder(), kMegabyte);
}

TEST_F(ScratchTest, ArraysOutliveTheFolder) {
  LargeVector<int> values(1 << 20, 7);
  CloseScratch();
  values.resize(1 << 21, 8);  // moves to memory
  EXPECT_EQ(values[0] + values.back(), 15);
  EXPECT_EQ(MeasureScratch().bytes, 0);
  OpenScratch(Folder(), kMegabyte);
}

TEST_F(ScratchTest, ThreadsAllocateAtTheSameTime) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([t] {
      for (int k = 1; k < 300; ++k) {
        const LargeVector<int> values(1000 + 37 * k, t);
        EXPECT_EQ(values.front() + values.back(), 2 * t);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

TEST_F(ScratchTest, ADiskThatIsTooSmallIsAnInputError) {
  EXPECT_THROW(LargeVector<double>(size_t{1} << 45), InputError);
}

}  // namespace
}  // namespace bundle
