#pragma once

/// Grammar of BAL files. bal.h defines the numbers.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/io/bal.h"
#include "core/io/input_file.h"
#include "core/io/text_cursor.h"

namespace bundle {

/// Reserves space for `count` rows, but only as many as the stored bytes make plausible. A strongly
/// compressed file may have more; these rows are appended at the usual cost of a vector.
template <typename Vector>
void ReservePlausibly(Vector* values, int32_t count, size_t width, uint64_t stored_size) {
  values->reserve(width * std::min<uint64_t>(static_cast<uint64_t>(count), stored_size));
}

inline bool IsFinite(double value) { return std::isfinite(value); }
inline bool IsPositive(double value) { return value > 0.0 && std::isfinite(value); }
/// Limit of the length of a rotation vector, against overflow. Angles of this size have no
/// meaningful digits.
inline bool IsAngle(double value) { return std::abs(value) < 1e100; }

/// Reads a file from its beginning to its end. A `Sink` takes the points and observations:
///     void Begin(int32_t num_images, int32_t num_points, int32_t num_observations,
///                uint64_t stored_size);
///     void Observation(int32_t image, int32_t point, double x, double y);   // y downwards
///     void Point(const double* xyz);                                        // in their order
template <typename Sink>
class BalReader {
 public:
  BalReader(InputFile& file, Sink& sink, const std::function<void()>& on_block)
      : file_(file), sink_(sink), cursor_(file, on_block) {}

  /// Returns the cameras.
  BalProblem Read() {
    ReadHeader();
    sink_.Begin(num_cameras_, num_points_, num_observations_, file_.stored_size());
    ReadObservations();
    ReadCameras();
    ReadPoints();
    if (!cursor_.AtEnd()) cursor_.Fail("the end of the file");
    return std::move(problem_);
  }

 private:
  void ReadHeader() {
    num_cameras_ = ReadCount("cameras");
    num_points_ = ReadCount("points");
    num_observations_ = ReadCount("observations");
    if (file_.is_compressed() || file_.stored_size() == 0) return;
    // A number takes a digit and, except for the last one, a separator.
    const int64_t num_numbers =
        3 + 4 * int64_t{num_observations_} + 9 * int64_t{num_cameras_} + 3 * int64_t{num_points_};
    const auto least = static_cast<uint64_t>(2 * num_numbers - 1);
    if (file_.stored_size() < least) {
      cursor_.FailWith("at least " + std::to_string(least) +
                           " bytes for the cameras, points and observations counted here",
                       "a file of " + std::to_string(file_.stored_size()) + " bytes");
    }
  }

  void ReadObservations() {
    for (int32_t i = 0; i < num_observations_; ++i) {
      const int32_t image = ReadIndex("camera", num_cameras_, i);
      const int32_t point = ReadIndex("point", num_points_, i);
      const double x = ReadDouble(IsFinite, "x", "observation", i);
      sink_.Observation(image, point, x, -ReadDouble(IsFinite, "y", "observation", i));
    }
  }

  void ReadCameras() {
    const uint64_t most = file_.stored_size();
    ReservePlausibly(&problem_.cam_from_world, num_cameras_, 7, most);
    ReservePlausibly(&problem_.rotations, num_cameras_, 3, most);
    ReservePlausibly(&problem_.camera_params, num_cameras_, 5, most);
    for (int32_t i = 0; i < num_cameras_; ++i) {
      double pose[6];
      for (int k = 0; k < 3; ++k) pose[k] = ReadDouble(IsAngle, "the rotation", "camera", i);
      for (int k = 3; k < 6; ++k) pose[k] = ReadDouble(IsFinite, "the translation", "camera", i);
      double cam_from_world[7];
      CamFromWorldFromBal(pose, cam_from_world);
      problem_.rotations.insert(problem_.rotations.end(), pose, pose + 3);
      problem_.cam_from_world.insert(problem_.cam_from_world.end(), cam_from_world,
                                     cam_from_world + 7);

      const double focal = ReadDouble(IsPositive, "the focal length", "camera", i);
      const double k1 = ReadDouble(IsFinite, "k1", "camera", i);
      const double k2 = ReadDouble(IsFinite, "k2", "camera", i);
      problem_.camera_params.insert(problem_.camera_params.end(), {focal, 0.0, 0.0, k1, k2});
    }
  }

  void ReadPoints() {
    constexpr const char* kAxes[] = {"X", "Y", "Z"};
    double xyz[3];
    for (int32_t i = 0; i < num_points_; ++i) {
      for (int k = 0; k < 3; ++k) xyz[k] = ReadDouble(IsFinite, kAxes[k], "point", i);
      sink_.Point(xyz);
    }
  }

  int32_t ReadCount(const char* what) {
    constexpr int32_t kMax = std::numeric_limits<int32_t>::max();
    int32_t count = 0;
    if (!cursor_.Read(&count, [](int32_t value) { return value >= 0; })) {
      cursor_.Fail(std::string("the number of ") + what + " (0 to " + std::to_string(kMax) + ")");
    }
    return count;
  }

  int32_t ReadIndex(const char* what, int32_t count, int32_t observation) {
    int32_t index = 0;
    const auto in_range = [count](int32_t value) { return value >= 0 && value < count; };
    if (!cursor_.Read(&index, in_range)) FailAtIndex(what, count, observation);
    return index;
  }

  double ReadDouble(bool (*accept)(double), const char* what, const char* owner, int32_t index) {
    double value = 0.0;
    if (!cursor_.Read(&value, accept)) FailAtDouble(accept, what, owner, index);
    return value;
  }

  [[noreturn]] void FailAtIndex(const char* what, int32_t count, int32_t observation) {
    const std::string range =
        count > 0 ? "0 to " + std::to_string(count - 1) : std::string("but there is no ") + what;
    cursor_.Fail(std::string("the ") + what + " of observation " + std::to_string(observation) +
                 " (" + range + ")");
  }

  [[noreturn]] void FailAtDouble(bool (*accept)(double), const char* what, const char* owner,
                                 int32_t index) {
    const char* range = accept == IsPositive ? "a finite number above 0"
                        : accept == IsAngle  ? "a number below 1e100"
                                             : "a finite number";
    cursor_.Fail(std::string(what) + " of " + owner + " " + std::to_string(index) + " (" + range +
                 ")");
  }

  InputFile& file_;
  Sink& sink_;
  TextCursor cursor_;
  int32_t num_cameras_ = 0;
  int32_t num_points_ = 0;
  int32_t num_observations_ = 0;
  BalProblem problem_;
};

/// Reads a file. At the end, `sink.kept` has the points and observations; returns these with the
/// cameras.
template <typename Sink>
BalProblem ReadKept(const std::filesystem::path& path, Sink sink,
                    const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  BalProblem problem = BalReader(*file, sink, on_block).Read();
  problem.points = std::move(sink.kept.points);
  problem.observation_image = std::move(sink.kept.observation_image);
  problem.observation_point = std::move(sink.kept.observation_point);
  problem.observation_xy = std::move(sink.kept.observation_xy);
  return problem;
}

}  // namespace bundle
