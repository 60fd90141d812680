#pragma once

/// Its content is in the header below.

#include "core/interface/summary.h"
