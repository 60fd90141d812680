#include "core/io/bal_writer.h"

#include <algorithm>
#include <charconv>
#include <string>

#include "core/io/bal_convention.h"

namespace bundle {
namespace {

/// Collects numbers as text and hands it on in blocks.
class NumberWriter {
 public:
  NumberWriter(OutputFile& file, const std::function<void()>& on_block)
      : file_(file), on_block_(on_block), buffer_(OutputFile::kBlockSize, '\0') {}

  template <typename T>
  void Write(T value, char separator) {
    if (buffer_.size() - used_ < kLongestNumber) Flush();
    char* end = buffer_.data() + buffer_.size();
    char* stop = std::to_chars(buffer_.data() + used_, end, value).ptr;
    *stop++ = separator;
    used_ = static_cast<size_t>(stop - buffer_.data());
  }

  void Flush() {
    if (on_block_) on_block_();
    file_.Write(std::string_view(buffer_).substr(0, used_));
    used_ = 0;
  }

 private:
  static constexpr size_t kLongestNumber = 32;

  OutputFile& file_;
  const std::function<void()>& on_block_;
  std::string buffer_;
  size_t used_ = 0;
};

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
