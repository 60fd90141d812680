#include "core/io/bal.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>

#include "core/io/files.h"
#include "core/io/number_writer.h"
#include "core/io/text_cursor.h"

namespace bundle {

namespace {

bool IsFinite(double value) { return std::isfinite(value); }
bool IsPositive(double value) { return value > 0.0 && std::isfinite(value); }
/// Beyond this the length of a rotation vector could overflow; its angle has no meaning long
/// before.
bool IsAngle(double value) { return std::abs(value) < 1e100; }

class BalReader {
 public:
  BalReader(InputFile& file, const std::function<void()>& on_block)
      : file_(file), cursor_(file, on_block) {}

  BalProblem Read() {
    ReadHeader();
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
    // A number takes a digit and, but for the last, a separator.
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
    Reserve(&problem_.observation_image, num_observations_, 1);
    Reserve(&problem_.observation_point, num_observations_, 1);
    Reserve(&problem_.observation_xy, num_observations_, 2);
    for (int32_t i = 0; i < num_observations_; ++i) {
      problem_.observation_image.push_back(ReadIndex("camera", num_cameras_, i));
      problem_.observation_point.push_back(ReadIndex("point", num_points_, i));
      problem_.observation_xy.push_back(ReadDouble(IsFinite, "x", "observation", i));
      problem_.observation_xy.push_back(-ReadDouble(IsFinite, "y", "observation", i));
    }
  }

  void ReadCameras() {
    Reserve(&problem_.cam_from_world, num_cameras_, 7);
    Reserve(&problem_.rotations, num_cameras_, 3);
    Reserve(&problem_.camera_params, num_cameras_, 5);
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
    Reserve(&problem_.points, num_points_, 3);
    for (int32_t i = 0; i < num_points_; ++i) {
      for (const char* axis : kAxes) {
        problem_.points.push_back(ReadDouble(IsFinite, axis, "point", i));
      }
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

  /// Reserves for `count` rows, but for no more than the stored bytes make plausible. What a
  /// strongly compressed file holds beyond is appended at a vector's usual price.
  template <typename T>
  void Reserve(std::vector<T>* values, int32_t count, size_t width) {
    values->reserve(width * std::min<uint64_t>(static_cast<uint64_t>(count), file_.stored_size()));
  }

  InputFile& file_;
  TextCursor cursor_;
  int32_t num_cameras_ = 0;
  int32_t num_points_ = 0;
  int32_t num_observations_ = 0;
  BalProblem problem_;
};

}  // namespace

BalProblem ReadBal(const std::filesystem::path& path, const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  return BalReader(*file, on_block).Read();
}

namespace {

void WriteObservations(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const double* xy = problem.observation_xy + 2 * i;
    const double* params = problem.camera_params + 5 * problem.observation_image[i];
    writer->Write(problem.observation_image[i], ' ');
    writer->Write(problem.observation_point[i], ' ');
    writer->Write(xy[0] - params[1], ' ');
    writer->Write(-(xy[1] - params[2]), '\n');
  }
}

void WriteCameras(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < problem.num_images; ++i) {
    double pose[6];
    BalFromCamFromWorld(problem.cam_from_world + 7 * i, pose);
    if (problem.rotations != nullptr && problem.keeps_rotation[i] != 0) {
      std::copy_n(problem.rotations + 3 * i, 3, pose);
    }
    for (const double value : pose) writer->Write(value, '\n');
    const double* params = problem.camera_params + 5 * i;
    for (const int k : {0, 3, 4}) writer->Write(params[k], '\n');
  }
}

void WritePoints(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < 3 * int64_t{problem.num_points}; ++i)
    writer->Write(problem.points[i], '\n');
}

}  // namespace

void WriteBal(const BalView& problem, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block) {
  OutputFile file(path, compression);
  NumberWriter writer(file, on_block);
  writer.Write(problem.num_images, ' ');
  writer.Write(problem.num_points, ' ');
  writer.Write(problem.num_observations, '\n');
  WriteObservations(problem, &writer);
  WriteCameras(problem, &writer);
  WritePoints(problem, &writer);
  writer.Flush();
  file.Close();
}

}  // namespace bundle
