#include "core/solve/memory.h"

#include <cstdio>
#include <fstream>
#include <limits>

namespace bundle {

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

double AvailableMemoryBytes() {
  std::ifstream file("/proc/meminfo");
  std::string key, unit;
  double kibibytes = 0;
  while (file >> key >> kibibytes >> unit) {
    if (key == "MemAvailable:") return 1024 * kibibytes;
  }
  return std::numeric_limits<double>::max();
}

std::string FormatBytes(double bytes) {
  const char* const units[] = {"B", "kB", "MB", "GB", "TB", "PB"};
  int unit = 0;
  while (bytes >= 999.5 && unit < 5) bytes /= 1000, ++unit;
  char text[32];
  std::snprintf(text, sizeof(text), bytes < 999.5 ? "%.3g %s" : "%.0f %s", bytes, units[unit]);
  return text;
}

}  // namespace bundle
