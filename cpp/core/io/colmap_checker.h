#pragma once

#include <string>

#include "core/io/colmap_index.h"

namespace bundle {

/// Reads the files of a COLMAP model from end to end and throws InputError at the first thing that
/// is wrong with them, naming file and line (or byte). COLMAP's own reader, for which this stands
/// guard, may take such a file silently, allocate what a corrupt count says, or give up without
/// saying where.
///
/// What COLMAP writes passes, and so does what is strange but legal: points without or with one
/// observation, several keypoints of one image in one track, models without rigs and frames.
void CheckColmapModel(const std::string& folder);

/// The scan alone, without the check of references, of the format that COLMAP reads where the
/// folder holds both; the index may keep the contents of the files.
ColmapIndex ScanColmapModel(const std::string& folder, bool keep_contents);

}  // namespace bundle
