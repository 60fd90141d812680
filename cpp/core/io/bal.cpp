#include "core/io/bal.h"

#include <algorithm>
#include <memory>

#include "core/io/bal_reader.h"
#include "core/io/bal_writer.h"
#include "core/io/input_file.h"
#include "core/io/number_writer.h"
#include "core/io/output_file.h"

namespace bundle {

namespace {

/// Stores a complete file.
struct KeepAll {
  BalProblem kept;

  void Begin(int32_t, int32_t num_points, int32_t num_observations, uint64_t stored_size) {
    ReservePlausibly(&kept.observation_image, num_observations, 1, stored_size);
    ReservePlausibly(&kept.observation_point, num_observations, 1, stored_size);
    ReservePlausibly(&kept.observation_xy, num_observations, 2, stored_size);
    num_points_ = num_points;
    stored_size_ = stored_size;
  }
  void Observation(int32_t image, int32_t point, double x, double y) {
    kept.observation_image.push_back(image);
    kept.observation_point.push_back(point);
    kept.observation_xy.push_back(x);
    kept.observation_xy.push_back(y);
  }
  void Point(const double* xyz) {
    if (kept.points.empty()) ReservePlausibly(&kept.points, num_points_, 3, stored_size_);
    kept.points.insert(kept.points.end(), xyz, xyz + 3);
  }

 private:
  int32_t num_points_ = 0;
  uint64_t stored_size_ = 0;
};

}  // namespace

BalProblem ReadBal(const std::filesystem::path& path, const std::function<void()>& on_block) {
  return ReadKept(path, KeepAll{}, on_block);
}

namespace {

/// Writes the observations of one file into another.
struct CopyObservations {
  const BalView& problem;
  NumberWriter* writer;

  void Begin(int32_t num_images, int32_t num_points, int32_t num_observations, uint64_t) const {
    if (num_images != problem.num_images || num_points != problem.num_points ||
        num_observations != problem.num_observations) {
      FailAsChanged();
    }
  }
  void Observation(int32_t image, int32_t point, double x, double y) const {
    const double xy[] = {x, y};
    WriteObservation(problem, image, point, xy, writer);
  }
  void Point(const double*) const {}
};

template <typename WriteObservations>
void WriteBal(const BalView& problem, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block, WriteObservations write_observations) {
  OutputFile file(path, compression);
  NumberWriter writer({&file}, on_block);
  writer.Write(problem.num_images, ' ');
  writer.Write(problem.num_points, ' ');
  writer.Write(problem.num_observations, '\n');
  write_observations(&writer);
  WriteCameras(problem, &writer);
  WritePoints(problem, &writer);
  writer.Flush();
  file.Close();
}

}  // namespace

void WriteBal(const BalView& problem, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block) {
  WriteBal(problem, path, compression, on_block,
           [&](NumberWriter* writer) { WriteObservations(problem, writer); });
}

void WriteBalLike(const std::filesystem::path& source, const BalView& problem,
                  const std::filesystem::path& path, Compression compression,
                  const std::function<void()>& on_block) {
  WriteBal(problem, path, compression, on_block, [&](NumberWriter* writer) {
    const std::unique_ptr<InputFile> file = InputFile::Open(source);
    CopyObservations sink{problem, writer};
    BalReader(*file, sink, on_block).Read();
  });
}

}  // namespace bundle
