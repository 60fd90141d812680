#pragma once

/// Its content is in the header below.

#include "core/ceres/reference_checks.h"
