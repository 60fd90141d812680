#pragma once

#include <memory>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"
#include "core/schur/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/state_records.h"

namespace bundle {

/// What the passes over the points need of a problem beside its states: which columns each image
/// has, the order of the elimination, where sums go in S, the kernels. It follows from the
/// structure of the problem, which image sees which point and what is refined, but for the
/// measurements.
struct SchurSetup {
  /// Keeps references to the problem and the layout. `is_reused`: Reset will be called.
  SchurSetup(const ProblemView& problem, const ParameterLayout& layout, const SolveOptions& options,
             BlockStructure structure, bool is_reused);
  SchurSetup(const SchurSetup&) = delete;
  SchurSetup& operator=(const SchurSetup&) = delete;

  /// Takes the problem's measurements and the options' loss anew, after these changed.
  void Reset(const SolveOptions& options);

  /// Cost of the observations with nothing to refine, by the same kernels.
  double FixedCost(const SolveOptions& options);

  const ProblemView& problem;
  const ParameterLayout& layout;
  const BlockStructure structure;
  const Kernels& kernels;
  const ModelGroups groups;
  EliminationPlan plan;
  EliminationInput input;
  Assembler assembler;

 private:
  struct FixedObservations {
    EliminationPlan plan;
    EliminationInput input;
    State state;
  };

  EliminationInput MakeInput(const SolveOptions& options, const EliminationPlan& points) const;

  const bool is_reused_;
  std::unique_ptr<FixedObservations> fixed_;  ///< where they will be needed again
};

}  // namespace bundle
