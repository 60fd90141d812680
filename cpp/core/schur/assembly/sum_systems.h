#pragma once

/// The reduced camera systems of all ranks, added up on rank 0, and its solution for all.

#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/sums/communicator.h"
#include "core/schur/assembly/assembler.h"

namespace bundle {

/// S and what belongs to it alone, right-hand side and block diagonal, become their sums on rank 0
/// and mean nothing elsewhere; twofold sums where the chunks' are, to be rounded then. The
/// structures have the same blocks on all ranks; where these stand may differ, as only rank 0
/// factorises: between its blocks is room for fill, elsewhere is none.
void SumSystems(Reducer* ranks, const BlockStructure& structure, const Assembler& assembler,
                CameraSums* sums);

/// All ranks get the solution that rank 0 found, and its step.
void ShareSolution(Reducer* ranks, LinearSolution* solution, std::vector<double>* step);

/// Gradient and squared norms become their sums, on all ranks; twofold sums on rank 0 alone.
void SumCameraVectors(Reducer* ranks, CameraSums* sums);

/// All ranks get those of rank 0.
void ShareCameraVectors(Reducer* ranks, CameraSums* sums);

}  // namespace bundle
