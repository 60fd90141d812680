#pragma once

/// Its content is in the header below.

#include "core/prepare/prepare.h"
