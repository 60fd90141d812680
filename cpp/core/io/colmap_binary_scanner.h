#pragma once

/// Scanner of COLMAP models in binary.

#include "core/io/colmap_scanner.h"

namespace bundle {

extern const ColmapScanner kColmapBinaryScanner;

}  // namespace bundle
