#include "core/io/colmap_checker.h"

#include <filesystem>
#include <string>
#include <system_error>

#include "core/error.h"
#include "core/io/colmap_index.h"
#include "core/io/printable.h"

namespace bundle {
namespace {

std::string JoinPath(const std::string& folder, const char* stem, const char* extension) {
  return (std::filesystem::path(folder) / (std::string(stem) + extension)).string();
}

bool Exists(const std::string& folder, const char* stem, const ColmapScanner& scanner) {
  std::error_code ignored;
  return std::filesystem::is_regular_file(JoinPath(folder, stem, scanner.extension), ignored);
}

/// The names of the files that this format needs and the folder lacks.
std::string MissingFiles(const std::string& folder, const ColmapScanner& scanner) {
  std::string missing;
  for (const char* stem : {"cameras", "images", "points3D"}) {
    if (Exists(folder, stem, scanner)) continue;
    missing += (missing.empty() ? "" : ", ") + std::string(stem) + scanner.extension;
  }
  return missing;
}

/// Scans one file after the other; unless they are kept, none stays longer than its scan.
ColmapIndex ScanFiles(const std::string& folder, const ColmapScanner& scanner, bool keep_contents) {
  ColmapIndex index;
  index.kind = scanner.kind;
  const auto scan = [&](const char* stem, ModelFile* file, void (*scan_file)(ColmapIndex*)) {
    *file = ModelFile(JoinPath(folder, stem, scanner.extension), scanner.kind);
    scan_file(&index);
    if (!keep_contents) file->Release();
  };
  if (Exists(folder, "rigs", scanner)) scan("rigs", &index.rigs_file, scanner.scan_rigs);
  scan("cameras", &index.cameras_file, scanner.scan_cameras);
  if (Exists(folder, "frames", scanner)) scan("frames", &index.frames_file, scanner.scan_frames);
  scan("images", &index.images_file, scanner.scan_images);
  scan("points3D", &index.points_file, scanner.scan_points);
  return index;
}

void CheckNotEmpty(const ColmapIndex& index) {
  const uint64_t start = index.kind == ModelFile::Kind::kText ? 1 : 0;
  if (index.cameras.empty()) index.cameras_file.Fail(start, "expected a camera, found none");
  if (index.images.empty()) index.images_file.Fail(start, "expected an image, found none");
}

}  // namespace

ColmapIndex ScanColmapModel(const std::string& folder, bool keep_contents) {
  const std::string missing_binary = MissingFiles(folder, kColmapBinaryScanner);
  const std::string missing_text = MissingFiles(folder, kColmapTextScanner);
  if (!missing_binary.empty() && !missing_text.empty()) {
    throw InputError(Printable(folder) + ": expected the files of a COLMAP model, found no " +
                     missing_binary + " (binary) and no " + missing_text + " (text)");
  }
  const bool binary = missing_binary.empty();
  ColmapIndex index =
      ScanFiles(folder, binary ? kColmapBinaryScanner : kColmapTextScanner, keep_contents);
  CheckNotEmpty(index);
  return index;
}

void CheckColmapModel(const std::string& folder) {
  CheckColmapReferences(ScanColmapModel(folder, /*keep_contents=*/false));
}

}  // namespace bundle
