#pragma once

/// Sums of the reduced camera systems over ranks, and the broadcast of the solution.

#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/schur/assembly/assembler.h"
#include "core/sums/communicator.h"

namespace bundle {

/// Sums S, its right-hand side and its block diagonal over ranks to rank 0. On other ranks they are
/// undefined afterwards. If the sums over chunks are double-doubles, the results are double-doubles
/// too and must be rounded afterwards.
///
/// The structures have the same blocks on all ranks, but at different offsets: only rank 0
/// factorises and has room for fill-in between its blocks.
void SumSystems(Communicator* communicator, const BlockStructure& structure,
                const Assembler& assembler, CameraSums* sums);

/// Broadcasts the solution of rank 0 and the step.
void BroadcastSolution(Communicator* communicator, LinearSolution* solution,
                       std::vector<double>* step);

/// Sums gradient and squared norms over ranks; all ranks receive them. Double-doubles are summed to
/// rank 0 only.
void SumCameraVectors(Communicator* communicator, CameraSums* sums);

/// Broadcasts gradient and squared norms of rank 0.
void BroadcastCameraVectors(Communicator* communicator, CameraSums* sums);

}  // namespace bundle
