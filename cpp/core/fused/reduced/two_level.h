#pragma once

#include <memory>

#include "core/fused/reduced/preconditioners.h"

namespace bundle::fused {

/// Schur-Jacobi and a correction on a coarse space. Keeps a reference to the structure.
std::unique_ptr<Preconditioner> MakeTwoLevelPreconditioner(const ReducedStructure& structure,
                                                           int num_threads);

}  // namespace bundle::fused
