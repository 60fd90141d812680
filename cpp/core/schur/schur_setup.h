#pragma once

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"
#include "core/schur/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/state_records.h"

namespace bundle::fused {

/// What the passes over the points need of a problem beside its states: which columns each image
/// has, the order of the elimination, where sums go in S, the kernels. It follows from the
/// structure of the problem, which image sees which point and what is refined, but for the
/// measurements.
struct SchurSetup {
  /// Keeps references to the problem and the layout.
  SchurSetup(const ProblemView& problem, const ParameterLayout& layout, const SolveOptions& options,
             BlockStructure structure);
  SchurSetup(const SchurSetup&) = delete;
  SchurSetup& operator=(const SchurSetup&) = delete;

  /// Cost of the observations with nothing to refine, by the same kernels.
  double FixedCost(const SolveOptions& options) const;

  const ProblemView& problem;
  const ParameterLayout& layout;
  const BlockStructure structure;
  const Kernels& kernels;
  const ModelGroups groups;
  const EliminationPlan plan;
  const EliminationInput input;
  const Assembler assembler;

 private:
  EliminationInput MakeInput(const SolveOptions& options, const EliminationPlan& plan) const;
};

}  // namespace bundle::fused
