#pragma once

/// Setup of the passes over the points: all their input except the states of a solve.

#include <cstdint>
#include <memory>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/parameter_layout.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/assembly/part_sums.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/state_records.h"
#include "core/sums/double_double.h"

namespace bundle {

/// Effect of the order of summation on a sum over points.
enum class SumOrder {
  kGrid,      ///< no effect (sum_grid.h)
  kSections,  ///< no effect if divisions follow sections (point_sections.h, double_double.h)
  kChunks,    ///< the last digits differ between plans with different chunks
};

/// Returns the effect for S with these numbers of block columns and blocks; `has_maps`:
/// Assembler::has_maps; `is_implicit`: S is not formed.
SumOrder ChooseSumOrder(LinearSolverType solver, int num_columns, int64_t num_block_columns,
                        int64_t num_blocks, bool has_maps, bool is_implicit);

/// Input of the passes over the points except states: columns of each image, order of the
/// elimination, places of the sums in S, and kernels. Except for the measurements, it follows from
/// the structure of the problem: the images that see each point, and the refined parameters.
struct SchurSetup {
  /// Keeps references to the problem and the layout. `is_reused`: Reset will be called.
  /// `is_implicit`: S is not formed, and the structure has only the blocks that one observation
  /// couples. `pool` must outlive the object.
  SchurSetup(const AdjustmentProblem& problem, const ParameterLayout& layout,
             const SolveOptions& options, BlockStructure structure, bool is_reused,
             bool is_implicit, ThreadPool* pool);
  SchurSetup(const SchurSetup&) = delete;
  SchurSetup& operator=(const SchurSetup&) = delete;

  /// Reads the changed measurements of the problem and the changed loss of the options.
  void Reset(const SolveOptions& options);

  /// Cost of the observations without free parameters, by the same kernels.
  DoubleDouble FixedCost(const SolveOptions& options);

  const AdjustmentProblem& problem;
  const ParameterLayout& layout;
  const BlockStructure structure;
  const Kernels& kernels;
  const ImageParts parts;
  Assembler assembler;
  const SumOrder sums;
  EliminationPlan plan;
  EliminationInput input;
  /// Only with hard-tied twists, if S is formed.
  std::unique_ptr<PartSums> part_sums;

  /// Structure and assembler of the sums over chunks.
  const BlockStructure& structure_of_sums() const {
    return part_sums != nullptr ? part_sums->structure() : structure;
  }
  const Assembler& assembler_of_sums() const {
    return part_sums != nullptr ? part_sums->assembler() : assembler;
  }

 private:
  struct FixedObservations {
    EliminationPlan plan;
    EliminationInput input;
    State state;
  };

  EliminationInput MakeInput(const SolveOptions& options, const EliminationPlan& points) const;

  const bool is_reused_;
  ThreadPool* const pool_;
  std::unique_ptr<FixedObservations> fixed_;  ///< only if they will be needed again
};

}  // namespace bundle
