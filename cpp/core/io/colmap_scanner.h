#pragma once

/// Scanners of the two formats of COLMAP models.

#include "core/io/colmap_index.h"

namespace bundle {

/// One of COLMAP's two formats: syntax, counts, single values. Each function scans one file of the
/// index into its records and throws InputError, naming file and line or byte.
/// `colmap_file_records.h` scans images and points.
struct ColmapScanner {
  ModelFile::Kind kind;
  const char* extension;
  void (*scan_rigs)(ColmapIndex*);
  void (*scan_cameras)(ColmapIndex*);
  void (*scan_frames)(ColmapIndex*);
};

}  // namespace bundle
