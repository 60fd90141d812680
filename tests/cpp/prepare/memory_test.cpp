
#include "core/prepare/memory.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "core/error.h"
#include "core/prepare/prepare.h"
#include "support/scene.h"
#include "support/temporary_folder.h"

namespace bundle {
namespace {

constexpr double kGiB = 1 << 30;

/// A machine with 8 GiB available, by its files.
class Machine {
 public:
  Machine() {
    Write("/proc/meminfo", "MemTotal:  16777216 kB\nMemAvailable:    8388608 kB\n");
    Write("/proc/self/statm", "1000 500 100 10 0 400 0\n");
  }
  void Write(const std::string& path, const std::string& text) const {
    const std::filesystem::path file(root() + path);
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file) << text;
  }
  std::string root() const { return folder_.path().native(); }
  double Available() const { return AvailableMemoryBytes(root()); }

 private:
  testing::TemporaryFolder folder_;
};

TEST(AvailableMemory, IsThatOfTheMachine) {
  EXPECT_EQ(Machine().Available(), 8 * kGiB);
  EXPECT_GT(AvailableMemoryBytes(), 0);
  EXPECT_GT(AvailableMemoryBytes("/nowhere"), 1e300);
}

TEST(AvailableMemory, IsWhatTheTightestControlGroupLeaves) {
  const Machine machine;
  machine.Write("/proc/self/cgroup", "0::/user/job\n");
  const std::string mount = "/sys/fs/cgroup";
  machine.Write(mount + "/user/job/memory.max", "max\n");
  machine.Write(mount + "/user/job/memory.current", "1073741824\n");
  EXPECT_EQ(machine.Available(), 8 * kGiB);
  machine.Write(mount + "/user/job/memory.max", "6442450944\n");
  EXPECT_EQ(machine.Available(), 5 * kGiB);
  machine.Write(mount + "/user/job/memory.stat", "anon 1\ninactive_file 536870912\n");
  EXPECT_EQ(machine.Available(), 5.5 * kGiB);
  machine.Write(mount + "/user/memory.max", "4294967296\n");
  machine.Write(mount + "/user/memory.current", "3221225472\n");
  EXPECT_EQ(machine.Available(), 1 * kGiB);
  machine.Write(mount + "/memory.max", "1073741824\n");  // as a container sees its own
  machine.Write(mount + "/memory.current", "805306368\n");
  EXPECT_EQ(machine.Available(), 0.25 * kGiB);
  machine.Write(mount + "/memory.current", "2147483648\n");
  EXPECT_EQ(machine.Available(), 0);
}

TEST(AvailableMemory, KnowsControlGroupsOfVersionOne) {
  const Machine machine;
  machine.Write("/proc/self/cgroup", "5:cpu,cpuacct:/job\n4:memory:/job\n");
  machine.Write("/sys/fs/cgroup/memory/job/memory.limit_in_bytes", "2147483648\n");
  machine.Write("/sys/fs/cgroup/memory/job/memory.usage_in_bytes", "1073741824\n");
  EXPECT_EQ(machine.Available(), 1 * kGiB);
  machine.Write("/sys/fs/cgroup/memory/memory.limit_in_bytes", "1610612736\n");
  machine.Write("/sys/fs/cgroup/memory/memory.usage_in_bytes", "1073741824\n");
  EXPECT_EQ(machine.Available(), 0.5 * kGiB);
}

// The limits are far above what any process maps, a sanitized one too: none of them is to run into
// them.
TEST(AvailableMemory, IsWhatTheLimitsOfTheProcessLeave) {
  const Machine machine;
  EXPECT_FALSE(HasMemoryLimit());
  const rlim_t used = (rlim_t{1} << 46) - (rlim_t{7} << 30);
  for (const auto resource : {RLIMIT_AS, RLIMIT_DATA}) {
    const std::string pages = std::to_string(used / 4096);
    machine.Write("/proc/self/statm", resource == RLIMIT_AS
                                          ? pages + " 500 100 10 0 400 0\n"
                                          : "1000 500 100 10 0 " + pages + " 0\n");
    rlimit before{};
    getrlimit(resource, &before);
    rlimit limit = before;
    limit.rlim_cur = rlim_t{1} << 46;
    setrlimit(resource, &limit);
    const bool has_limit = HasMemoryLimit();
    const double available = machine.Available();
    setrlimit(resource, &before);
    EXPECT_TRUE(has_limit);
    EXPECT_EQ(available, 7 * kGiB);
  }
}

TEST(DenseMatrices, TakeWhatTheirSolverAllocates) {
  ProblemShape shape;
  shape.num_residuals = 1000;
  shape.num_free_points = 100;
  shape.num_camera_columns = 60;
  const auto bytes = [&](LinearSolverType type, bool cameras = false) {
    return PredictDenseMatrixBytes(type, shape, cameras);
  };
  EXPECT_EQ(bytes(LinearSolverType::kDenseSchur), 8.0 * 60 * 60);
  EXPECT_EQ(bytes(LinearSolverType::kDenseSchur, true), 8.0 * 300 * 300);
  EXPECT_EQ(bytes(LinearSolverType::kDenseNormalCholesky), 8.0 * (1360 * 360 + 360 * 360));
  EXPECT_EQ(bytes(LinearSolverType::kDenseQr), 16.0 * 1360 * 360);
  EXPECT_EQ(bytes(LinearSolverType::kSparseSchur), 0);
}

TEST(WorkingMemory, CountsPairsBuffersAndBothStates) {
  testing::SceneOptions options;
  options.num_images = 20;
  options.num_points = 100;  // seen by all
  const testing::Scene scene = testing::MakeScene(options);
  const AdjustmentProblem problem = scene.View();
  const PreparedSolve prepared = PrepareSolve(problem, SolveOptions());
  const double observations = 2000, pairs = 100 * 190;
  const auto predict = [&](bool has_pairs, int num_threads, double buffer_bytes) {
    return PredictFusedWorkingBytes(prepared.layout, prepared.track_lengths, false, has_pairs,
                                    num_threads, buffer_bytes);
  };
  const double one = predict(true, 1, 0);
  EXPECT_EQ(one, 28 * observations + 84 * 100 + 4 * pairs);
  EXPECT_EQ(predict(false, 1, 0), one - 4 * pairs);
  EXPECT_EQ(predict(true, 4, 1e6), one + 12e6);

  ProblemShape shape = ShapeOf(prepared.layout, 4000);
  const double ceres = PredictCeresWorkingBytes(shape);
  shape.num_free_points += 10;
  EXPECT_EQ(PredictCeresWorkingBytes(shape), ceres + 8200);
  EXPECT_GT(ceres, 390 * 2000 + 820 * 100 + 8 * 4000 * 9);
}

}  // namespace
}  // namespace bundle
