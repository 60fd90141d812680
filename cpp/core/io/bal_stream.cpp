#include "core/io/bal_stream.h"

#include <string>
#include <utility>

#include "core/io/bal_writer.h"

namespace bundle {

namespace {

/// The first line, with the same length for any number of observations.
std::string FirstLine(int64_t num_images, int64_t num_points, int64_t num_observations) {
  constexpr size_t kDigits = 10;  // of 2^31
  std::string count = std::to_string(num_observations);
  count.resize(kDigits, ' ');
  return std::to_string(num_images) + ' ' + std::to_string(num_points) + ' ' + count + '\n';
}

}  // namespace

BalStream::BalStream(const std::vector<std::filesystem::path>& paths, int64_t num_images,
                     int64_t num_points, std::function<void()> on_block)
    : path_(paths.at(0)),
      num_images_(num_images),
      num_points_(num_points),
      on_block_(std::move(on_block)) {
  for (const std::filesystem::path& path : paths) {
    files_.emplace_back(path, Compression::kNone).Write(FirstLine(num_images_, num_points_, 0));
  }
}

void BalStream::AddObservations(const BalView& part) {
  std::vector<OutputFile*> all;
  for (OutputFile& file : files_) all.push_back(&file);
  NumberWriter writer(all, on_block_);
  WriteObservations(part, &writer);
  writer.Flush();
  num_observations_ += part.num_observations;
}

void BalStream::AddCameras(int file, const BalView& part) {
  NumberWriter writer({&files_[file]}, on_block_);
  WriteCameras(part, &writer);
  writer.Flush();
}

void BalStream::AddPoints(int file, const BalView& part) {
  NumberWriter writer({&files_[file]}, on_block_);
  WritePoints(part, &writer);
  writer.Flush();
}

void BalStream::Close() {
  for (OutputFile& file : files_) {
    file.Overwrite(0, FirstLine(num_images_, num_points_, num_observations_));
    file.Close();
  }
}

}  // namespace bundle
