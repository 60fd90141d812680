#include "core/prepare/memory.h"

/// Memory: predicted for each solver, and available to this process.

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <limits>
#include <sstream>
#include <vector>

#include "core/scratch/large_vector.h"

namespace bundle {
namespace {

constexpr double kUnlimited = std::numeric_limits<double>::max();

/// The number in a file, or after `key` in it; `otherwise` if it has no number, such as "max".
double ReadNumber(const std::string& path, const std::string& key, double otherwise) {
  std::ifstream file(path);
  std::string word;
  double number = 0;
  while (!key.empty() && file >> word && word != key) continue;
  return file >> number ? number : otherwise;
}

double LeftByMachine(const std::string& root) {
  return 1024 * ReadNumber(root + "/proc/meminfo", "MemAvailable:", kUnlimited / 1024);
}

/// Memory that one control group leaves. Its files have other names in version 1.
double LeftByGroup(const std::string& group, const char* limit, const char* usage,
                   const char* droppable) {
  const double most = ReadNumber(group + limit, "", kUnlimited);
  if (most == kUnlimited) return kUnlimited;
  const double used = ReadNumber(group + usage, "", 0);
  return most - used + std::min(used, ReadNumber(group + "/memory.stat", droppable, 0));
}

/// Parent groups of a group limit it, too. In a container, its path may not be mounted; then the
/// root of the mounted groups is used.
double LeftByControlGroups(const std::string& root) {
  const std::string mount = root + "/sys/fs/cgroup";
  double left = kUnlimited;
  std::ifstream file(root + "/proc/self/cgroup");
  for (std::string line; std::getline(file, line);) {  // "4:memory:/user" or "0::/user"
    const size_t first = line.find(':'), second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const std::string controllers = "," + line.substr(first + 1, second - first - 1) + ",";
    const bool unified = controllers == ",,";
    if (!unified && controllers.find(",memory,") == std::string::npos) continue;
    for (std::string path = line.substr(second + 1);; path.resize(path.rfind('/'))) {
      if (path == "/") path.clear();
      left = std::min(
          left, unified
                    ? LeftByGroup(mount + path, "/memory.max", "/memory.current", "inactive_file")
                    : LeftByGroup(mount + "/memory" + path, "/memory.limit_in_bytes",
                                  "/memory.usage_in_bytes", "total_inactive_file"));
      if (path.rfind('/') == std::string::npos) break;
    }
  }
  return left;
}

double LeftByLimit(int resource, double used) {
  rlimit limit{};
  if (getrlimit(resource, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return kUnlimited;
  return static_cast<double>(limit.rlim_cur) - used;
}

double LeftByLimits(const std::string& root) {
  if (!HasMemoryLimit()) return kUnlimited;
  // Fields, in pages: total, resident, shared, text, unused, data and stack.
  std::ifstream file(root + "/proc/self/statm");
  double pages[6] = {};
  for (double& count : pages) file >> count;
  const auto page = static_cast<double>(sysconf(_SC_PAGESIZE));
  return std::min(LeftByLimit(RLIMIT_AS, page * pages[0]),
                  LeftByLimit(RLIMIT_DATA, page * pages[5]));
}

}  // namespace

bool HasMemoryLimit() {
  return LeftByLimit(RLIMIT_AS, 0) < kUnlimited || LeftByLimit(RLIMIT_DATA, 0) < kUnlimited;
}

double PredictDenseMatrixBytes(LinearSolverType solver, const ProblemShape& shape,
                               bool cameras_eliminated) {
  const double camera_columns = static_cast<double>(shape.num_camera_columns);
  const double point_columns = 3.0 * static_cast<double>(shape.num_free_points);
  const double columns = camera_columns + point_columns;
  const double rows = static_cast<double>(shape.num_residuals) + columns;  // with the LM diagonal
  const double reduced = cameras_eliminated ? point_columns : camera_columns;
  switch (solver) {
    case LinearSolverType::kDenseSchur:
      return sizeof(double) * reduced * reduced;
    case LinearSolverType::kDenseNormalCholesky:
      return sizeof(double) * (rows * columns + columns * columns);
    case LinearSolverType::kDenseQr:
      return 2 * sizeof(double) * rows * columns;  // the Jacobian and the copy that is factorised
    default:
      return 0;
  }
}

double AvailableMemoryBytes(const std::string& root) {
  return std::max(0.0,
                  std::min({LeftByMachine(root), LeftByControlGroups(root), LeftByLimits(root)}));
}

double AvailableMemoryFor(double bytes) {
  constexpr double kFitsAnywhere = 1 << 25;
  return bytes < kFitsAnywhere ? std::max(0.0, LeftByLimits("")) : AvailableMemoryBytes();
}

double PredictFusedWorkingBytes(const ParameterLayout& layout,
                                const LargeVector<int64_t>& track_lengths, bool has_sigmas,
                                bool has_pairs, int num_threads, double buffer_bytes) {
  // Image, measurement, places in chunk and tile, and entries of two kinds
  // (schur/elimination_plan.h). During sorting, an observation takes more, but the other arrays are
  // not allocated yet.
  const double bytes_per_observation = 20 + 4 + 4 + (has_sigmas ? 8 : 0);
  // Two states, the scale of the columns, and the index of the point in the plan. The output is
  // allocated after the last step, when only one state is left.
  constexpr double kBytesPerPoint = 3 * 24 + 8 + 4;
  constexpr double kBytesPerPair = 4;  // without the blocks of tiles, which are fewer
  constexpr double kBuffersPerThread = 3;
  const auto num_points = static_cast<int>(track_lengths.size());
  double observations = 0, pairs = 0;
  for (int p = 0; p < num_points; ++p) {
    const auto length = static_cast<double>(track_lengths[p]);
    observations += length;
    if (has_pairs && layout.point_is_free(p)) pairs += length * (length - 1) / 2;
  }
  double arrays =
      bytes_per_observation * observations + kBytesPerPoint * num_points + kBytesPerPair * pairs;
  const auto resident = static_cast<double>(ScratchResidentBytes());
  if (resident >= 0) arrays = std::min(arrays, resident);
  return arrays + kBuffersPerThread * num_threads * buffer_bytes;
}

double PredictCeresWorkingBytes(const ProblemShape& shape) {
  constexpr double kBytesPerObservation = 390, kBytesPerPoint = 820;
  const double columns_per_block =
      static_cast<double>(shape.num_camera_columns) / std::max(1, shape.num_camera_blocks);
  const auto residuals = static_cast<double>(shape.num_residuals);
  return kBytesPerObservation * residuals / 2 +
         kBytesPerPoint * static_cast<double>(shape.num_free_points) +
         sizeof(double) * residuals * (3 + columns_per_block);
}

std::string FormatBytes(double bytes) {
  const char* const units[] = {"B", "kB", "MB", "GB", "TB", "PB"};
  int unit = 0;
  while (bytes >= 999.5 && unit < 5) bytes /= 1000, ++unit;
  char text[32];
  std::snprintf(text, sizeof(text), bytes < 999.5 ? "%.3g %s" : "%.0f %s", bytes, units[unit]);
  return text;
}

namespace {

/// The free memory if `bytes` exceeds nine tenths of it; otherwise -1.
double AvailableIfTooLittle(double bytes) {
  const double available = AvailableMemoryFor(bytes);
  return FitsIntoMemory(bytes, available) ? -1 : available;
}

}  // namespace

void RefuseTooMuchMemory(LinearSolverType type, double bytes, const char* what,
                         const char* instead) {
  const double available = AvailableIfTooLittle(bytes);
  if (available < 0) return;
  throw NotEnoughMemoryError("linear_solver_type: " + UpperName(type, kLinearSolverTypes) +
                             " needs " + FormatBytes(bytes) + " for its " + what +
                             "; this machine has " + FormatBytes(available) + " free; use " +
                             instead);
}

void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape,
                         bool cameras_eliminated) {
  RefuseTooMuchMemory(type, PredictDenseMatrixBytes(type, shape, cameras_eliminated),
                      "dense matrices", "sparse_schur or iterative_schur");
}

bool FitsIntoMemory(double bytes, double available) { return bytes <= 0.9 * available; }

void RefuseTooMuchMemory(double working_bytes) {
  const double available = AvailableIfTooLittle(working_bytes);
  if (available < 0) return;
  throw NotEnoughMemoryError(
      "not enough memory: the observations and points take " + FormatBytes(working_bytes) +
      " within a solve; this machine has " + FormatBytes(available) + " free" +
      (ScratchResidentBytes() >= 0 ? ""
                                   : "; `bundle refine --out-of-core DIR` keeps them on a disk"));
}

void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes, double working_bytes) {
  RefuseTooMuchMemory(type, factor_bytes + working_bytes,
                      working_bytes > 0 ? "factor, observations and points" : "factor",
                      "iterative_schur");
}

}  // namespace bundle
