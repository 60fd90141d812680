#pragma once

/// Scanner of COLMAP models in text.

#include "core/io/colmap_scanner.h"

namespace bundle {

extern const ColmapScanner kColmapTextScanner;

}  // namespace bundle
